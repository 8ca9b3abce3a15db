-- Friction over speed, time and thermal state, and friction against the robot's own baseline.

-- The time that a warm-up curve stands on; beyond it the curve is extrapolated. NULL in fits made before.
ALTER TABLE warmup_fit ADD COLUMN first_min REAL;
ALTER TABLE warmup_fit ADD COLUMN last_min REAL;
-- Whether the warm friction a lies beyond the record.
ALTER TABLE warmup_fit ADD COLUMN a_extrapolated INTEGER CHECK (a_extrapolated IN (0, 1));

-- Friction over speed of one joint and direction in one cycle. Asymmetry, forward less backward, belongs to
-- the joint and stands with both directions.
CREATE TABLE friction_speed_fit (
    friction_speed_fit_id  INTEGER PRIMARY KEY,
    cycle_id               INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                  INTEGER NOT NULL CHECK (joint >= 1),
    direction              INTEGER NOT NULL CHECK (direction IN (-1, 1)),
    model                  TEXT NOT NULL CHECK (model IN ('coulomb', 'coulomb_viscous', 'power_law', 'stribeck', 'polynomial')),
    slowest_rad_s          REAL NOT NULL,
    fastest_rad_s          REAL NOT NULL,
    rmsd_nm                REAL,
    reduced_chi_square     REAL,
    points                 INTEGER NOT NULL CHECK (points >= 0),
    asymmetry_nm           REAL,
    asymmetry_std_error_nm REAL,
    UNIQUE (cycle_id, joint, direction)
) STRICT;

CREATE TABLE friction_speed_coefficient (
    friction_speed_fit_id INTEGER NOT NULL REFERENCES friction_speed_fit ON DELETE CASCADE,
    name                  TEXT NOT NULL,
    value                 REAL NOT NULL,
    std_error             REAL,
    -- Held at zero, since the data alone would have friction drive the joint.
    at_bound              INTEGER NOT NULL CHECK (at_bound IN (0, 1)),
    PRIMARY KEY (friction_speed_fit_id, name)
) STRICT, WITHOUT ROWID;

-- How a joint warms and cools. Renewed with every run.
CREATE TABLE friction_law (
    robot_id                INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint                   INTEGER NOT NULL CHECK (joint >= 1),
    slow_min                REAL NOT NULL,
    slow_std_error_min      REAL,
    fast_min                REAL NOT NULL,
    fast_std_error_min      REAL,
    slow_share              REAL NOT NULL,
    slow_share_std_error    REAL,
    cooling_ratio           REAL NOT NULL,
    cooling_ratio_std_error REAL,
    relative_rmsd           REAL,
    explained               REAL,
    runs                    INTEGER NOT NULL CHECK (runs >= 0),
    points                  INTEGER NOT NULL CHECK (points >= 0),
    remarks                 TEXT,
    -- JSON, row after row: warm friction by level, cold part by level, logarithms of the slow and the fast
    -- time constant in seconds, share of the slow part, logarithm of the cooling ratio.
    covariance              TEXT NOT NULL CHECK (json_valid(covariance)),
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE friction_level (
    robot_id          INTEGER NOT NULL,
    joint             INTEGER NOT NULL,
    speed_fraction    REAL NOT NULL,
    warm_nm           REAL NOT NULL,
    warm_std_error_nm REAL,
    cold_nm           REAL NOT NULL CHECK (cold_nm >= 0),
    cold_std_error_nm REAL,
    PRIMARY KEY (robot_id, joint, speed_fraction),
    FOREIGN KEY (robot_id, joint) REFERENCES friction_law ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE TABLE run_friction_index (
    run_id                   INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint                    INTEGER NOT NULL CHECK (joint >= 1),
    friction_index           REAL NOT NULL,
    friction_index_std_error REAL,
    ambient_coldness           REAL NOT NULL,
    ambient_coldness_std_error REAL,
    coldness_at_start          REAL NOT NULL,
    points                     INTEGER NOT NULL CHECK (points >= 0),
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;

-- The contract -------------------------------------------------------------------------------------

DROP VIEW warmup_fits;
CREATE VIEW warmup_fits AS
SELECT robot.name AS robot,
       warmup_fit.run_id,
       warmup_fit.joint,
       warmup_fit.speed_fraction,
       warmup_fit.model,
       warmup_fit.a_nm,
       warmup_fit.b_nm,
       warmup_fit.t1_min,
       warmup_fit.c_nm,
       warmup_fit.t2_min,
       warmup_fit.a_std_error_nm,
       warmup_fit.b_std_error_nm,
       warmup_fit.t1_std_error_min,
       warmup_fit.c_std_error_nm,
       warmup_fit.t2_std_error_min,
       warmup_fit.rmsd_nm,
       warmup_fit.samples,
       warmup_fit.first_min,
       warmup_fit.last_min,
       warmup_fit.a_extrapolated
FROM warmup_fit
JOIN robot USING (robot_id);

CREATE VIEW friction_speed_fits AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       fit.joint,
       fit.direction,
       fit.model,
       coefficient.name AS coefficient,
       coefficient.value,
       coefficient.std_error,
       coefficient.at_bound,
       fit.slowest_rad_s,
       fit.fastest_rad_s,
       fit.rmsd_nm,
       fit.reduced_chi_square,
       fit.points,
       fit.asymmetry_nm,
       fit.asymmetry_std_error_nm
FROM friction_speed_fit AS fit
JOIN friction_speed_coefficient AS coefficient USING (friction_speed_fit_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW friction_map AS
SELECT robot.name AS robot,
       law.joint,
       level.speed_fraction,
       level.warm_nm,
       level.warm_std_error_nm,
       level.cold_nm,
       level.cold_std_error_nm,
       law.slow_min,
       law.slow_std_error_min,
       law.fast_min,
       law.fast_std_error_min,
       law.slow_share,
       law.slow_share_std_error,
       law.cooling_ratio,
       law.cooling_ratio_std_error,
       law.explained,
       law.relative_rmsd,
       law.runs,
       law.points,
       law.remarks
FROM friction_law AS law
JOIN friction_level AS level USING (robot_id, joint)
JOIN robot USING (robot_id);

CREATE VIEW friction_index AS
SELECT robot.name AS robot,
       found.run_id,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
       found.joint,
       found.friction_index,
       found.friction_index_std_error,
       found.ambient_coldness,
       found.ambient_coldness_std_error,
       found.coldness_at_start,
       found.points
FROM run_friction_index AS found
JOIN run USING (run_id)
JOIN robot USING (robot_id);
