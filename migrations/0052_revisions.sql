-- A conclusion reads a bounded part of the history. What it follows from has revisions, and what is kept names the revision that it
-- was made from: nothing is deleted when its source changes.

DROP TRIGGER run_series_goes_with_status;
DROP TRIGGER run_series_goes_with_new_cycle;
DROP TRIGGER run_series_goes_with_cycle;
DROP TRIGGER run_series_goes_with_changed_cycle;
DROP TRIGGER run_series_goes_with_new_rmsd;
DROP TRIGGER run_series_goes_with_changed_rmsd;
DROP TRIGGER run_series_goes_with_rmsd;
DROP TRIGGER run_series_goes_with_new_level;
DROP TRIGGER run_series_goes_with_changed_level;
DROP TRIGGER run_series_goes_with_level;
DROP TRIGGER run_series_goes_with_new_parameter;
DROP TRIGGER run_series_goes_with_changed_parameter;
DROP TRIGGER run_series_goes_with_parameter;
DROP TRIGGER run_series_goes_with_new_summary;
DROP TRIGGER run_series_goes_with_changed_summary;
DROP TRIGGER run_series_goes_with_summary;
DROP TRIGGER run_series_goes_with_new_index;
DROP TRIGGER run_series_goes_with_changed_index;
DROP TRIGGER run_series_goes_with_index;
DROP TRIGGER run_friction_series_goes_with_run;
DROP TRIGGER run_friction_series_goes_with_cycle;
DROP TRIGGER run_friction_series_goes_with_changed_cycle;
DROP TRIGGER run_friction_series_goes_with_new_point;
DROP TRIGGER run_friction_series_goes_with_changed_point;
DROP TRIGGER run_friction_series_goes_with_point;
DROP TRIGGER run_friction_series_goes_with_new_refusal;
DROP TRIGGER run_friction_series_goes_with_changed_refusal;
DROP TRIGGER run_friction_series_goes_with_refusal;
DROP TRIGGER run_brief_goes_with_series;
DROP TRIGGER settled_history_goes_with_new_test;
DROP TRIGGER settled_history_goes_with_changed_test;
DROP TRIGGER settled_history_goes_with_test;
DROP TRIGGER settled_history_goes_with_brief;
DROP TRIGGER settled_history_goes_with_changed_reason;
DROP TRIGGER settled_history_goes_with_new_refusal;
DROP TRIGGER settled_history_goes_with_changed_refusal;
DROP TRIGGER settled_history_goes_with_refusal;
DROP TRIGGER settled_history_goes_with_new_response;
DROP TRIGGER settled_history_goes_with_changed_response;
DROP TRIGGER settled_history_goes_with_response;
DROP TRIGGER settled_history_goes_with_new_work;
DROP TRIGGER settled_history_goes_with_changed_work;
DROP TRIGGER settled_history_goes_with_work;
DROP TRIGGER friction_plan_goes_with_new_test;
DROP TRIGGER friction_plan_goes_with_changed_test;
DROP TRIGGER friction_plan_goes_with_test;
DROP TRIGGER friction_plan_goes_with_friction;
DROP TRIGGER friction_plan_goes_with_new_work;
DROP TRIGGER friction_plan_goes_with_changed_work;
DROP TRIGGER friction_plan_goes_with_work;
DROP TRIGGER settled_history_goes_with_new_log;
DROP TRIGGER settled_history_goes_with_changed_log;
DROP TRIGGER settled_history_goes_with_log;
DROP TRIGGER settled_history_goes_with_changed_work_run;
DROP TRIGGER settled_history_goes_with_work_run;
DROP TRIGGER settled_history_goes_with_error_of_test;
DROP TRIGGER settled_history_goes_with_test_without_error;
DROP TRIGGER settled_history_goes_with_test_with_error;
DROP TRIGGER run_changes_history;
DROP TRIGGER run_leaves_history;
DROP TRIGGER maintenance_changes_history;
DROP TRIGGER maintenance_taken_back_changes_history;

DROP TABLE run_brief;
DROP TABLE run_series;
DROP TABLE run_friction_series;
DROP TABLE friction_plan;
UPDATE anomaly SET settled_history_id = NULL WHERE settled_history_id IS NOT NULL;
DROP TABLE settled_history;

-- How often the figures of the run have changed.
ALTER TABLE run ADD COLUMN revision INTEGER NOT NULL DEFAULT 0;
-- How often a test before the latest one, or work on the robot, has changed.
ALTER TABLE robot ADD COLUMN past_revision INTEGER NOT NULL DEFAULT 0;

-- The figures of a complete test that detectors compare, and what they found in its cycles (store::robot::figures::run_summary).
CREATE TABLE run_summary (
    run_id     INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    -- It holds while this is run.revision and the program has this method.
    revision   INTEGER NOT NULL,
    method     INTEGER NOT NULL,
    numbers    BLOB NOT NULL,
    judgements BLOB
) STRICT;

-- Friction points of a test at one speed level, for fits over tests (store::robot::figures::friction_series).
CREATE TABLE run_friction_series (
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    run_id         INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    speed_fraction REAL NOT NULL,
    revision       INTEGER NOT NULL,
    method         INTEGER NOT NULL,
    numbers        BLOB NOT NULL,
    PRIMARY KEY (run_id, speed_fraction)
) STRICT;
CREATE INDEX run_friction_series_by_robot ON run_friction_series (robot_id);

-- The tests that the next tests of a robot are compared with (store::robot::indices::friction_plan).
CREATE TABLE friction_plan (
    robot_id      INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    -- It holds while this is robot.past_revision and the program has this method and so many tests of a baseline.
    revision      INTEGER NOT NULL,
    method        INTEGER NOT NULL,
    baseline_runs INTEGER NOT NULL,
    numbers       BLOB NOT NULL
) STRICT;

-- The part of a robot's history before a boundary (method::detect::window). Conclusions do not judge it again.
CREATE TABLE settled_history (
    settled_history_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id           INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    kind               TEXT NOT NULL CHECK (kind IN ('test', 'production')),
    runs               INTEGER NOT NULL CHECK (runs > 0),
    -- Start of the first run that is not settled, and of the latest run that this follows from, microseconds since 1970.
    boundary_at        INTEGER NOT NULL,
    follows_until      INTEGER NOT NULL,
    -- The latest run that was stored then: later ones that began before the boundary are not judged.
    latest_run_id      INTEGER NOT NULL,
    numbers            BLOB NOT NULL,
    UNIQUE (robot_id, kind, runs)
) STRICT;
CREATE INDEX settled_history_by_time ON settled_history (robot_id, follows_until);

CREATE TRIGGER run_changes_history AFTER UPDATE OF status, started_at, robot_id, kind, robot_model_id, figures_hash ON run
WHEN OLD.status = 'complete' OR NEW.status = 'complete'
BEGIN
    UPDATE robot
    SET history = history + 1,
        -- a test that comes last changes nothing before it
        past_revision = past_revision + (
            'test' IN (OLD.kind, NEW.kind)
            AND (OLD.status = 'complete'
                 OR EXISTS (SELECT 1 FROM run AS later
                            WHERE later.robot_id = NEW.robot_id AND later.kind = 'test' AND later.status = 'complete'
                                  AND (later.started_at, later.run_id) > (NEW.started_at, NEW.run_id))))
    WHERE robot_id IN (OLD.robot_id, NEW.robot_id);
END;
CREATE TRIGGER run_leaves_history AFTER DELETE ON run
WHEN OLD.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1, past_revision = past_revision + 1 WHERE robot_id = OLD.robot_id;
END;
CREATE TRIGGER maintenance_changes_history AFTER INSERT ON maintenance
BEGIN
    UPDATE robot SET history = history + 1, past_revision = past_revision + 1 WHERE robot_id = NEW.robot_id;
END;
CREATE TRIGGER maintenance_taken_back_changes_history AFTER DELETE ON maintenance
BEGIN
    UPDATE robot SET history = history + 1, past_revision = past_revision + 1 WHERE robot_id = OLD.robot_id;
END;

-- What a run comes to changes with its cycles, their estimates, and what is made of them at its end or later.
CREATE TRIGGER run_counts_revision AFTER UPDATE OF status, cycles_stored ON run
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER cycle_counts_revision AFTER UPDATE OF number, status, doubtful, estimator ON cycle
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_joint_summary_counts_revision AFTER UPDATE ON run_joint_summary
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER parameter_statistic_counts_revision AFTER INSERT ON parameter_statistic
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_friction_counts_revision AFTER INSERT ON run_friction
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;
