-- Conclusions from long ordinary work read so many logs and no more, as from tests: what had ended long before is settled.

-- What was settled by an earlier version is not believed anyway.
UPDATE anomaly SET settled_history_id = NULL WHERE settled_history_id IS NOT NULL;
DROP TABLE settled_history;

-- What is settled of a robot's history of one kind before a boundary, so many runs from its first on (numerics::detect::window says
-- what, store::robot::settled_rows has the format). It follows from the runs until follows_until and from what basis is a hash of:
-- settings, method and version of the program, first tests of other robots of the model. It goes when one of these runs changes,
-- goes or comes late, and when work is entered that was done before; anomalies that it has settled are looked at again then.
CREATE TABLE settled_history (
    settled_history_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id           INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    kind               TEXT NOT NULL CHECK (kind IN ('test', 'production')),
    runs               INTEGER NOT NULL CHECK (runs > 0),
    -- Start of the latest run that it follows from, microseconds since 1970.
    follows_until      INTEGER NOT NULL,
    basis              INTEGER NOT NULL,
    numbers            BLOB NOT NULL,
    UNIQUE (robot_id, kind, runs)
) STRICT;

CREATE INDEX settled_history_by_time ON settled_history (robot_id, follows_until);

-- A log of ordinary work changes as what it comes to does, or as its run does.
CREATE TRIGGER settled_history_goes_with_new_log AFTER INSERT ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_log AFTER UPDATE ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_log AFTER DELETE ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_work_run AFTER UPDATE OF robot_id, kind, status, started_at ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'production' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER settled_history_goes_with_work_run AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'production'
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;
-- What a test leaves of its own torque is a limit of the logs that are held against it.
CREATE TRIGGER settled_history_goes_with_error_of_test AFTER UPDATE OF relative_rmsd ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_test_without_error AFTER DELETE ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_test_with_error AFTER INSERT ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
END;
-- What stands for the cycles of a test has another form (store::robot::run_brief): the next conclusions make it anew.
DELETE FROM run_brief;
