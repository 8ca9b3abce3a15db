-- Conclusions from a long history read so many tests and no more: what had ended long before is settled.

-- What is settled of a robot's history before a boundary, so many tests from its first on (numerics::detect::runs::window says
-- what, store::robot::settled has the format). It follows from the tests until follows_until and from what basis is a hash of:
-- settings, method and version of the program, first tests of other robots of the model. It goes when one of these tests changes,
-- goes or comes late, and when work is entered that was done before; anomalies that it has settled are looked at again then.
CREATE TABLE settled_history (
    settled_history_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id           INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    tests              INTEGER NOT NULL CHECK (tests > 0),
    -- Start of the latest test that it follows from, microseconds since 1970.
    follows_until      INTEGER NOT NULL,
    basis              INTEGER NOT NULL,
    numbers            BLOB NOT NULL,
    UNIQUE (robot_id, tests)
) STRICT;

CREATE INDEX settled_history_by_time ON settled_history (robot_id, follows_until);

-- What has settled an anomaly; NULL while conclusions look at it.
ALTER TABLE anomaly ADD COLUMN settled_history_id INTEGER REFERENCES settled_history ON DELETE SET NULL;

CREATE INDEX anomaly_by_settled_history ON anomaly (settled_history_id) WHERE settled_history_id IS NOT NULL;
CREATE INDEX anomaly_not_settled ON anomaly (robot_id, anomaly_id) WHERE settled_history_id IS NULL;

CREATE TRIGGER settled_history_goes_with_new_test AFTER INSERT ON run
WHEN NEW.status = 'complete' AND NEW.kind = 'test'
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER settled_history_goes_with_changed_test AFTER UPDATE OF robot_id, kind, status, started_at, cycles_stored, robot_model_id, figures_hash ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER settled_history_goes_with_test AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;
CREATE TRIGGER settled_history_goes_with_brief AFTER DELETE ON run_brief
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_reason AFTER UPDATE OF reason ON cycle
WHEN 'refused' IN (OLD.status, NEW.status)
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_new_refusal AFTER INSERT ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_refusal AFTER UPDATE ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER settled_history_goes_with_refusal AFTER DELETE ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER settled_history_goes_with_new_response AFTER INSERT ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_response AFTER UPDATE ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_response AFTER DELETE ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_new_work AFTER INSERT ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER settled_history_goes_with_changed_work AFTER UPDATE ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER settled_history_goes_with_work AFTER DELETE ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
END;

-- What the next tests of a robot with a long history are compared with for their friction index (store::robot::friction_plan has
-- the format). It follows from the tests until follows_until and goes as what is settled does.
CREATE TABLE friction_plan (
    robot_id      INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    follows_until INTEGER NOT NULL,
    basis         INTEGER NOT NULL,
    numbers       BLOB NOT NULL
) STRICT;

CREATE TRIGGER friction_plan_goes_with_new_test AFTER INSERT ON run
WHEN NEW.status = 'complete' AND NEW.kind = 'test'
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER friction_plan_goes_with_changed_test AFTER UPDATE OF robot_id, kind, status, started_at, robot_model_id, figures_hash ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER friction_plan_goes_with_test AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;
CREATE TRIGGER friction_plan_goes_with_friction AFTER DELETE ON run_friction
BEGIN
    DELETE FROM friction_plan
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER friction_plan_goes_with_new_work AFTER INSERT ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER friction_plan_goes_with_changed_work AFTER UPDATE ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER friction_plan_goes_with_work AFTER DELETE ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
END;

-- Logs of ordinary work of a robot, without the tests between them.
CREATE INDEX run_production ON run (robot_id, status, started_at, run_id) WHERE kind = 'production';
