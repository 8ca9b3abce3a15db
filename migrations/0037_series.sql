-- Conclusions from a long history read one row a test in place of hundreds, and find what is unfinished without looking at
-- what is complete.

-- What detectors compare over the cycles of a complete test, in one piece: friction and RMSD of each cycle, and mean
-- parameters (store::robot::run_series has the format). It follows from other tables, is made when conclusions are drawn,
-- and goes when one of these tables changes.
CREATE TABLE run_series (
    run_id  INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    numbers BLOB NOT NULL
) STRICT;

CREATE TRIGGER run_series_goes_with_status AFTER UPDATE OF status ON run
WHEN NEW.status <> OLD.status
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_new_cycle AFTER INSERT ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_cycle AFTER DELETE ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
-- rows that go with their cycle are the cycle's matter: it is gone when they go
CREATE TRIGGER run_series_goes_with_new_rmsd AFTER INSERT ON torque_rmsd
WHEN NEW.stage = 'all' AND NEW.verification = 'self'
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_changed_rmsd AFTER UPDATE ON torque_rmsd
WHEN 'all' IN (OLD.stage, NEW.stage)
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_series_goes_with_rmsd AFTER DELETE ON torque_rmsd
WHEN OLD.stage = 'all' AND OLD.verification = 'self'
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_new_level AFTER INSERT ON cycle_friction_level
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_changed_level AFTER UPDATE ON cycle_friction_level
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_series_goes_with_level AFTER DELETE ON cycle_friction_level
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_new_parameter AFTER INSERT ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_parameter AFTER UPDATE ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_parameter AFTER DELETE ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;

-- Complete tests of a robot in the order of their starts, without logs of ordinary work between them.
CREATE INDEX run_complete_test ON run (robot_id, started_at, run_id) WHERE kind = 'test' AND status = 'complete';
-- Files of unfinished runs are asked for with every look at the folders.
CREATE INDEX run_unfinished ON run (run_id) WHERE status = 'streaming';
-- Few cycles are refused.
CREATE INDEX cycle_refused ON cycle (run_id) WHERE status = 'refused';
-- Of a log of ordinary work, most windows have been joined.
CREATE INDEX cycle_with_factors ON cycle (run_id, number) WHERE factors_gone IS NULL AND status = 'complete';
