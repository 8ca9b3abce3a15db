-- What later identification and verification need of a cycle's rows, so that they need no export:
-- triangular factors of [regressor | torque]. And what is made from them.

-- Which parameter each column of a joint's factor belongs to. A description's columns come from its
-- structure, so that all its cycles share a row; another choice of columns is another row, and
-- factors of different rows are never joined.
CREATE TABLE factor_layout (
    factor_layout_id INTEGER PRIMARY KEY,
    robot_model_id   INTEGER NOT NULL REFERENCES robot_model ON DELETE CASCADE,
    -- JSON: for each joint, from the first, the model_parameter_id of each column.
    columns          TEXT NOT NULL CHECK (json_valid(columns)),
    UNIQUE (robot_model_id, columns)
) STRICT;

CREATE TABLE cycle_factor_layout (
    cycle_id         INTEGER PRIMARY KEY REFERENCES cycle ON DELETE CASCADE,
    factor_layout_id INTEGER NOT NULL REFERENCES factor_layout
) STRICT;

CREATE INDEX cycle_factor_layout_by_layout ON cycle_factor_layout (factor_layout_id);

-- Every row of a cycle is in exactly one of its factors; 'between' are the rows between stages.
CREATE TABLE torque_factor (
    torque_factor_id INTEGER PRIMARY KEY,
    cycle_id         INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    stage            TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'between')),
    -- Whether the joint moves at its low-speed threshold or faster.
    motion           TEXT NOT NULL CHECK (motion IN ('moving', 'slow')),
    rows             INTEGER NOT NULL CHECK (rows >= 1),
    -- Upper triangle, column after column, 8-byte little-endian floats; the last column is the torque.
    -- Last, so that the other columns are read without its overflow pages.
    factor           BLOB NOT NULL,
    UNIQUE (cycle_id, stage, motion, joint)
) STRICT;

-- RMSD of the cycle's own parameters in the first and the last third of the warming stage, by time:
-- friction falls inside a cycle. Columns as in torque_rmsd.
CREATE TABLE warming_rmsd (
    cycle_id             INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                INTEGER NOT NULL CHECK (joint >= 1),
    part                 TEXT NOT NULL CHECK (part IN ('start', 'end')),
    rmsd_nm              REAL,
    relative_rmsd        REAL,
    moving_rmsd_nm       REAL,
    moving_relative_rmsd REAL,
    samples              INTEGER NOT NULL CHECK (samples >= 0),
    moving_samples       INTEGER NOT NULL CHECK (moving_samples >= 0),
    PRIMARY KEY (cycle_id, joint, part)
) STRICT, WITHOUT ROWID;

-- Parameters identified on chosen cycles, kept under a name.
CREATE TABLE parameter_set (
    parameter_set_id        INTEGER PRIMARY KEY,
    name                    TEXT NOT NULL UNIQUE,
    robot_model_id          INTEGER NOT NULL REFERENCES robot_model,
    samples                 INTEGER NOT NULL CHECK (samples >= 1),
    condition_number        REAL,
    scaled_condition_number REAL,
    residual_std_nm         REAL,
    -- As run.ingested_at.
    saved_at                INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;

CREATE INDEX parameter_set_by_model ON parameter_set (robot_model_id);

CREATE TABLE parameter_set_value (
    parameter_set_id   INTEGER NOT NULL REFERENCES parameter_set ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value              REAL NOT NULL,
    std_error          REAL,
    PRIMARY KEY (parameter_set_id, model_parameter_id)
) STRICT, WITHOUT ROWID;

-- The cycles behind a set. Without foreign keys: a set outlives its runs, and a run's number is never
-- given to another one.
CREATE TABLE parameter_set_source (
    parameter_set_id INTEGER NOT NULL REFERENCES parameter_set ON DELETE CASCADE,
    run_id           INTEGER NOT NULL,
    cycle            INTEGER NOT NULL,
    robot            TEXT NOT NULL,
    PRIMARY KEY (parameter_set_id, run_id, cycle)
) STRICT, WITHOUT ROWID;

-- The contract -------------------------------------------------------------------------------------

CREATE VIEW warming_contrast AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       first_third.joint,
       first_third.rmsd_nm AS start_rmsd_nm,
       last_third.rmsd_nm AS end_rmsd_nm,
       first_third.relative_rmsd AS start_relative_rmsd,
       last_third.relative_rmsd AS end_relative_rmsd,
       first_third.moving_rmsd_nm AS start_moving_rmsd_nm,
       last_third.moving_rmsd_nm AS end_moving_rmsd_nm,
       first_third.moving_relative_rmsd AS start_moving_relative_rmsd,
       last_third.moving_relative_rmsd AS end_moving_relative_rmsd,
       first_third.samples AS start_samples,
       last_third.samples AS end_samples,
       first_third.moving_samples AS start_moving_samples,
       last_third.moving_samples AS end_moving_samples
FROM warming_rmsd AS first_third
JOIN warming_rmsd AS last_third
     ON last_third.cycle_id = first_third.cycle_id AND last_third.joint = first_third.joint AND last_third.part = 'end'
JOIN cycle ON cycle.cycle_id = first_third.cycle_id
JOIN run USING (run_id)
JOIN robot USING (robot_id)
WHERE first_third.part = 'start';

CREATE VIEW parameter_sets AS
SELECT parameter_set.name AS parameter_set,
       robot_model.name AS model,
       model_parameter.joint,
       model_parameter.name AS parameter,
       parameter_set_value.value,
       parameter_set_value.std_error,
       model_parameter.unit,
       model_parameter.grouping,
       (SELECT count(*) FROM parameter_set_source
        WHERE parameter_set_source.parameter_set_id = parameter_set.parameter_set_id) AS cycles,
       parameter_set.samples,
       parameter_set.condition_number,
       parameter_set.scaled_condition_number,
       parameter_set.residual_std_nm
FROM parameter_set
JOIN robot_model USING (robot_model_id)
JOIN parameter_set_value USING (parameter_set_id)
JOIN model_parameter USING (model_parameter_id);

CREATE VIEW parameter_set_sources AS
SELECT parameter_set.name AS parameter_set,
       parameter_set_source.robot,
       parameter_set_source.run_id,
       parameter_set_source.cycle
FROM parameter_set_source
JOIN parameter_set USING (parameter_set_id);
