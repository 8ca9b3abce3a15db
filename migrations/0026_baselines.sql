-- Friction baselines that stay: chosen once for each joint and epoch, stored with the runs that they stand on. An epoch
-- lasts from one maintenance or change of description to the next.

-- BLAKE3 of all that a run's figures depend on in the description: beside what decides the meaning of parameters, gear
-- ratios, offsets, torque constants, limits and speed levels. NULL in runs from before.
ALTER TABLE run ADD COLUMN figures_hash BLOB CHECK (length(figures_hash) = 32);

-- What is known of a complete test for its friction index; a test without a row is looked at by the next conclusion.
CREATE TABLE run_friction (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    -- BLAKE3 of what its indices were computed from: its baselines, itself and the motion before it. Indices of another
    -- basis are computed anew. NULL where no joint has a baseline for it.
    basis  BLOB CHECK (length(basis) = 32)
) STRICT;

-- Usable friction points of the joint's best level. Six make a full test, which may be one of a baseline.
CREATE TABLE run_friction_points (
    run_id INTEGER NOT NULL REFERENCES run_friction ON DELETE CASCADE,
    joint  INTEGER NOT NULL CHECK (joint >= 1),
    points INTEGER NOT NULL CHECK (points >= 0),
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER run_friction_is_looked_at_again AFTER UPDATE OF status ON run
WHEN NEW.status <> OLD.status
BEGIN
    DELETE FROM run_friction WHERE run_id = NEW.run_id;
END;

-- One row each time a baseline is formed; never changed but for the end of its validity and the ordinal.
CREATE TABLE friction_baseline (
    friction_baseline_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id         INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    -- Ordinal of the joint's epoch by its first test, from 0.
    epoch            INTEGER NOT NULL CHECK (epoch >= 0),
    cause            TEXT NOT NULL CHECK (cause IN ('first_test', 'maintenance', 'description')),
    -- No foreign key: what is said of a baseline outlives a wrong entry of maintenance.
    maintenance_id   INTEGER,
    begins_at        INTEGER NOT NULL,
    basis            BLOB NOT NULL CHECK (length(basis) = 32),
    -- The held map by level, a JSON array of {"speed_fraction", "warm_nm", "cold_nm"}; NULL where there is none.
    levels           TEXT CHECK (json_valid(levels)),
    -- Why there is no map.
    remark           TEXT,
    -- Wall time.
    formed_at        INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    replaced_at      INTEGER,
    replaced_because TEXT,
    CHECK ((replaced_at IS NULL) = (replaced_because IS NULL))
) STRICT;
CREATE UNIQUE INDEX friction_baseline_in_force ON friction_baseline (robot_id, joint, epoch) WHERE replaced_at IS NULL;
CREATE INDEX friction_baseline_by_robot ON friction_baseline (robot_id);

-- No foreign key: a baseline names its runs also when one of them is gone.
CREATE TABLE friction_baseline_run (
    friction_baseline_id INTEGER NOT NULL REFERENCES friction_baseline ON DELETE CASCADE,
    run_id               INTEGER NOT NULL,
    PRIMARY KEY (friction_baseline_id, run_id)
) STRICT, WITHOUT ROWID;
CREATE INDEX friction_baseline_by_run ON friction_baseline_run (run_id);

-- Which baseline the map of a joint was fitted on; NULL in maps from before.
ALTER TABLE friction_law ADD COLUMN basis BLOB CHECK (length(basis) = 32);

-- Maintenance changes what follows from a robot's history.
CREATE TRIGGER maintenance_changes_history AFTER INSERT ON maintenance
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
END;

CREATE TRIGGER maintenance_taken_back_changes_history AFTER DELETE ON maintenance
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

-- Indices from before stand on baselines that moved.
UPDATE robot SET history = history + 1
WHERE robot_id IN (SELECT robot_id FROM run WHERE status = 'complete' AND kind = 'test');

-- The contract -------------------------------------------------------------------------------------

-- The baselines in force, a row a run that one stands on.
CREATE VIEW baselines AS
SELECT robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       strftime('%Y-%m-%dT%H:%M:%fZ', baseline.begins_at / 1000000.0, 'unixepoch') AS begins_at,
       of_run.run_id,
       strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch') AS started_at,
       baseline.levels,
       baseline.remark
FROM friction_baseline AS baseline
JOIN robot USING (robot_id)
JOIN friction_baseline_run AS of_run USING (friction_baseline_id)
LEFT JOIN run ON run.run_id = of_run.run_id
WHERE baseline.replaced_at IS NULL;

-- When baselines were formed, and why they were replaced. Its times but `begins_at` are wall time.
CREATE VIEW baseline_changes AS
SELECT baseline.friction_baseline_id,
       robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       strftime('%Y-%m-%dT%H:%M:%fZ', baseline.begins_at / 1000000.0, 'unixepoch') AS begins_at,
       (SELECT json_group_array(of_run.run_id) FROM friction_baseline_run AS of_run
        WHERE of_run.friction_baseline_id = baseline.friction_baseline_id) AS run_ids,
       strftime('%Y-%m-%dT%H:%M:%fZ', baseline.formed_at / 1000000.0, 'unixepoch') AS formed_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', baseline.replaced_at / 1000000.0, 'unixepoch') AS replaced_at,
       baseline.replaced_because
FROM friction_baseline AS baseline
JOIN robot USING (robot_id);
