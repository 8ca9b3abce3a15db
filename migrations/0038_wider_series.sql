-- Conclusions from a long history read one row a test: the series of a test holds what it comes to for each joint too, and
-- friction points that fits over tests stand on have a row a test. Shipped queries read what they show, whatever is stored besides.

-- Of the format before, without figures by joint; they are made again when conclusions are drawn.
DELETE FROM run_series;

CREATE TRIGGER run_series_goes_with_new_summary AFTER INSERT ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_summary AFTER UPDATE ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_summary AFTER DELETE ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;
CREATE TRIGGER run_series_goes_with_new_index AFTER INSERT ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_index AFTER UPDATE ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_index AFTER DELETE ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;

-- Friction points of a complete test at one speed level, in one piece (store::robot::friction_series has the format), for
-- the first dozen and the latest two dozen tests of each robot. It follows from other tables and goes when one of these
-- changes.
CREATE TABLE run_friction_series (
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    run_id         INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    speed_fraction REAL NOT NULL,
    numbers        BLOB NOT NULL,
    PRIMARY KEY (run_id, speed_fraction)
) STRICT;
CREATE INDEX run_friction_series_by_robot ON run_friction_series (robot_id);

CREATE TRIGGER run_friction_series_goes_with_run AFTER UPDATE OF status, robot_id ON run
WHEN NEW.status <> OLD.status OR NEW.robot_id IS NOT OLD.robot_id
BEGIN
    DELETE FROM run_friction_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_friction_series_goes_with_cycle AFTER DELETE ON cycle
BEGIN
    DELETE FROM run_friction_series WHERE run_id = OLD.run_id;
END;
CREATE TRIGGER run_friction_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
BEGIN
    DELETE FROM run_friction_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
-- rows that go with their cycle are the cycle's matter: it is gone when they go
CREATE TRIGGER run_friction_series_goes_with_new_point AFTER INSERT ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_friction_series_goes_with_changed_point AFTER UPDATE ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_friction_series_goes_with_point AFTER DELETE ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER run_friction_series_goes_with_new_refusal AFTER INSERT ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_friction_series_goes_with_changed_refusal AFTER UPDATE OF cycle_id ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_friction_series_goes_with_refusal AFTER DELETE ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;

-- Shipped queries find the latest test of a robot, and the tests of a span of time, without looking at all runs.
CREATE INDEX run_by_start_text ON run (started_at_text);
CREATE INDEX run_of_robot_by_start_text ON run (robot_id, started_at_text, run_id);
-- Few cycles are refused, doubtful or have remarks. The conditions are written as the view `cycles` hands them on, COLLATE
-- and all: SQLite takes an index of some rows only where the text agrees.
CREATE INDEX cycle_shown_as_refused ON cycle (run_id)
WHERE CASE WHEN doubtful THEN 'doubtful' ELSE status END COLLATE BINARY = 'refused';
CREATE INDEX cycle_with_remarks ON cycle (started_at_text)
WHERE remarks IS NOT NULL OR CASE WHEN doubtful THEN 'doubtful' ELSE status END COLLATE BINARY = 'doubtful';
