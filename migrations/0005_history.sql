-- Estimators of one's choice on history: how a kept set was made, and whole histories identified again.

ALTER TABLE parameter_set ADD COLUMN estimator TEXT NOT NULL DEFAULT 'ordinary'
    CHECK (estimator IN ('ordinary', 'weighted', 'per-joint', 'huber', 'prior'));
-- What the standard errors stand on: the scatter between cycles, or the residual and the share of rows
-- that are independent.
ALTER TABLE parameter_set ADD COLUMN error_basis TEXT NOT NULL DEFAULT 'independent_rows'
    CHECK (error_basis IN ('cycles', 'independent_rows'));

DROP VIEW parameter_sets;
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
       parameter_set.residual_std_nm,
       parameter_set.estimator,
       parameter_set.error_basis
FROM parameter_set
JOIN robot_model USING (robot_model_id)
JOIN parameter_set_value USING (parameter_set_id)
JOIN model_parameter USING (model_parameter_id);

-- A history identified again, cycle by cycle, kept under a name. Names are shared with parameter_set: no
-- name means two things.
CREATE TABLE reestimate (
    reestimate_id  INTEGER PRIMARY KEY,
    name           TEXT NOT NULL UNIQUE,
    robot_model_id INTEGER NOT NULL REFERENCES robot_model,
    estimator      TEXT NOT NULL CHECK (estimator IN ('ordinary', 'weighted', 'per-joint', 'huber', 'prior')),
    -- As run.ingested_at.
    saved_at       INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;

CREATE INDEX reestimate_by_model ON reestimate (robot_model_id);

-- Without foreign keys to runs, as parameter_set_source: what was kept outlives its runs.
CREATE TABLE reestimate_cycle (
    reestimate_cycle_id INTEGER PRIMARY KEY,
    reestimate_id       INTEGER NOT NULL REFERENCES reestimate ON DELETE CASCADE,
    robot               TEXT NOT NULL,
    run_id              INTEGER NOT NULL,
    cycle               INTEGER NOT NULL,
    -- Why it, or some of its joints, gave no parameters.
    reason              TEXT,
    UNIQUE (reestimate_id, run_id, cycle)
) STRICT;

-- Figures of an identification; by joint where each joint's rows were taken alone, else of joint 0.
CREATE TABLE reestimate_view (
    reestimate_cycle_id     INTEGER NOT NULL REFERENCES reestimate_cycle ON DELETE CASCADE,
    seen_by_joint           INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    samples                 INTEGER NOT NULL CHECK (samples >= 1),
    condition_number        REAL,
    scaled_condition_number REAL,
    residual_std_nm         REAL,
    PRIMARY KEY (reestimate_cycle_id, seen_by_joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE reestimate_value (
    reestimate_cycle_id INTEGER NOT NULL REFERENCES reestimate_cycle ON DELETE CASCADE,
    seen_by_joint       INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    model_parameter_id  INTEGER NOT NULL REFERENCES model_parameter,
    value               REAL NOT NULL,
    std_error           REAL,
    -- Half the width of the 95 % interval: Student's quantile is no function of SQL.
    half_width_95       REAL,
    data_share          REAL,
    PRIMARY KEY (reestimate_cycle_id, seen_by_joint, model_parameter_id)
) STRICT, WITHOUT ROWID;

CREATE INDEX reestimate_value_by_parameter ON reestimate_value (model_parameter_id);

-- As parameter_statistic.
CREATE TABLE reestimate_statistic (
    reestimate_id      INTEGER NOT NULL REFERENCES reestimate ON DELETE CASCADE,
    robot              TEXT NOT NULL,
    run_id             INTEGER NOT NULL,
    seen_by_joint      INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    "window"           TEXT NOT NULL CHECK ("window" IN ('all', 'after_5')),
    mean               REAL NOT NULL,
    min                REAL NOT NULL,
    max                REAL NOT NULL,
    d_mm               REAL,
    d_se               REAL,
    sdv                REAL,
    cycles             INTEGER NOT NULL CHECK (cycles >= 1),
    PRIMARY KEY (reestimate_id, run_id, seen_by_joint, model_parameter_id, "window")
) STRICT, WITHOUT ROWID;

CREATE INDEX reestimate_statistic_by_parameter ON reestimate_statistic (model_parameter_id);

-- The contract -------------------------------------------------------------------------------------

CREATE VIEW reestimated_cycles AS
SELECT reestimate.name AS estimate,
       reestimate.estimator,
       reestimate_cycle.robot,
       reestimate_cycle.run_id,
       reestimate_cycle.cycle,
       nullif(reestimate_view.seen_by_joint, 0) AS seen_by_joint,
       reestimate_view.samples,
       reestimate_view.condition_number,
       reestimate_view.scaled_condition_number,
       reestimate_view.residual_std_nm,
       reestimate_cycle.reason
FROM reestimate
JOIN reestimate_cycle USING (reestimate_id)
LEFT JOIN reestimate_view USING (reestimate_cycle_id);

CREATE VIEW reestimated_parameters AS
SELECT reestimate.name AS estimate,
       reestimate_cycle.robot,
       reestimate_cycle.run_id,
       reestimate_cycle.cycle,
       nullif(reestimate_value.seen_by_joint, 0) AS seen_by_joint,
       model_parameter.joint,
       model_parameter.name AS parameter,
       reestimate_value.value,
       reestimate_value.std_error,
       reestimate_value.value - reestimate_value.half_width_95 AS interval_low,
       reestimate_value.value + reestimate_value.half_width_95 AS interval_high,
       reestimate_value.data_share,
       model_parameter.unit,
       model_parameter.grouping
FROM reestimate
JOIN reestimate_cycle USING (reestimate_id)
JOIN reestimate_value USING (reestimate_cycle_id)
JOIN model_parameter USING (model_parameter_id);

CREATE VIEW reestimated_statistics AS
SELECT reestimate.name AS estimate,
       reestimate_statistic.robot,
       reestimate_statistic.run_id,
       nullif(reestimate_statistic.seen_by_joint, 0) AS seen_by_joint,
       model_parameter.joint,
       model_parameter.name AS parameter,
       reestimate_statistic."window",
       reestimate_statistic.mean,
       reestimate_statistic.min,
       reestimate_statistic.max,
       reestimate_statistic.d_mm,
       reestimate_statistic.d_se,
       reestimate_statistic.sdv,
       reestimate_statistic.cycles
FROM reestimate
JOIN reestimate_statistic USING (reestimate_id)
JOIN model_parameter USING (model_parameter_id);
