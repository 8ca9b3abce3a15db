-- Which estimator made a figure, so that stored cycles can be estimated again from their factors, and the 95 %
-- interval of a parameter as it was computed: Student's quantile is no function of SQL.

-- What the standard errors of a cycle stand on: the scatter of blocks of rows, or the residual and the share of rows
-- that are independent, which is all that stored factors know. NULL where errors were not made for intervals.
ALTER TABLE cycle ADD COLUMN error_basis TEXT CHECK (error_basis IN ('blocks', 'independent_rows'));
UPDATE cycle SET error_basis = 'blocks'
WHERE EXISTS (SELECT 1 FROM cycle_parameter
              WHERE cycle_parameter.cycle_id = cycle.cycle_id AND degrees_of_freedom IS NOT NULL);
-- A cycle that could not be estimated again: the estimator that was wanted, and why it keeps its own.
ALTER TABLE cycle ADD COLUMN estimator_wanted TEXT CHECK (estimator_wanted IN ('ordinary', 'weighted', 'huber'));
ALTER TABLE cycle ADD COLUMN estimator_reason TEXT;
-- Cycles of another estimator than the configured one are looked for at every start.
CREATE INDEX cycle_by_estimator ON cycle (estimator, run_id);
CREATE INDEX cycle_with_kept_estimate ON cycle (estimator_wanted) WHERE estimator_wanted IS NOT NULL;

-- Half the width of the 95 % interval. Rows stored before have NULL until the program that migrates has filled them;
-- those without degrees of freedom have no interval.
ALTER TABLE cycle_parameter ADD COLUMN half_width_95 REAL;
-- How far filling has come: one row while there is something to do.
CREATE TABLE interval_fill (
    after_cycle_id INTEGER NOT NULL
) STRICT;
INSERT INTO interval_fill (after_cycle_id) SELECT 0 WHERE EXISTS (SELECT 1 FROM cycle_parameter);

-- Estimator of the reference run's parameters; NULL for self-verification, which is by the cycle's own.
ALTER TABLE torque_rmsd ADD COLUMN estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber'));
UPDATE torque_rmsd SET estimator = 'ordinary' WHERE verification = 'cross';
-- Estimator of the parameters that the thirds of the warming stage were verified with, where the cycle has been
-- estimated again since: their rows are not among the stored factors.
ALTER TABLE warming_rmsd ADD COLUMN estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber'));
-- Estimator of the test's parameters.
ALTER TABLE production_check ADD COLUMN estimator TEXT NOT NULL DEFAULT 'ordinary'
    CHECK (estimator IN ('ordinary', 'weighted', 'huber'));

-- Estimator of the cycles that the torque deviations of a summary are taken over: they compare with those of the
-- same estimator only.
ALTER TABLE run_joint_summary ADD COLUMN estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber'));
UPDATE run_joint_summary
SET estimator = (SELECT cycle.estimator FROM cycle
                 WHERE cycle.run_id = run_joint_summary.run_id AND cycle.samples IS NOT NULL
                 ORDER BY cycle.number DESC LIMIT 1);

-- What the points show of the fast part of a warm-up curve: its value at the first point, and the time constant that it
-- does not exceed with 95 %. NULL without a fast part and in fits made before.
ALTER TABLE warmup_fit ADD COLUMN c_first_nm REAL;
ALTER TABLE warmup_fit ADD COLUMN c_first_std_error_nm REAL;
ALTER TABLE warmup_fit ADD COLUMN t2_max_min REAL;

-- The contract -------------------------------------------------------------------------------------

DROP VIEW cycles;

CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch') AS started_at,
       cycle.duration_s,
       cycle.rows,
       cycle.status,
       cycle.reason,
       cycle.remarks,
       cycle.sample_rate_hz,
       cycle.cutoff_hz,
       cycle.samples,
       cycle.condition_number,
       cycle.scaled_condition_number,
       cycle.residual_std_nm,
       cycle.estimator,
       cycle.error_basis,
       cycle.estimator_reason
FROM cycle
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW cycle_parameters;

CREATE VIEW cycle_parameters AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       model_parameter.joint,
       model_parameter.name AS parameter,
       cycle_parameter.value,
       cycle_parameter.std_error,
       model_parameter.unit,
       model_parameter.grouping,
       cycle_parameter.std_error / abs(cycle_parameter.value) AS relative_std_error,
       cycle_parameter.degrees_of_freedom,
       cycle_parameter.value - cycle_parameter.half_width_95 AS interval_low,
       cycle_parameter.value + cycle_parameter.half_width_95 AS interval_high
FROM cycle_parameter
JOIN model_parameter USING (model_parameter_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW cycle_rmsd;

CREATE VIEW cycle_rmsd AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       torque_rmsd.joint,
       torque_rmsd.stage,
       torque_rmsd.verification,
       torque_rmsd.reference_run_id,
       torque_rmsd.rmsd_nm,
       torque_rmsd.relative_rmsd,
       torque_rmsd.moving_rmsd_nm,
       torque_rmsd.moving_relative_rmsd,
       torque_rmsd.samples,
       torque_rmsd.moving_samples,
       ifnull(torque_rmsd.estimator, cycle.estimator) AS estimator
FROM torque_rmsd
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW warming_contrast;

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
       last_third.moving_samples AS end_moving_samples,
       ifnull(first_third.estimator, cycle.estimator) AS estimator
FROM warming_rmsd AS first_third
JOIN warming_rmsd AS last_third
     ON last_third.cycle_id = first_third.cycle_id AND last_third.joint = first_third.joint AND last_third.part = 'end'
JOIN cycle ON cycle.cycle_id = first_third.cycle_id
JOIN run USING (run_id)
JOIN robot USING (robot_id)
WHERE first_third.part = 'start';

DROP VIEW production_checks;

CREATE VIEW production_checks AS
SELECT run.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch') AS started_at,
       cycle.duration_s,
       cycle.rows,
       production_check.joint,
       production_check.reference_run_id,
       production_check.moving_relative_rmsd,
       production_check.moving_rmsd_nm,
       production_check.relative_rmsd,
       production_check.rmsd_nm,
       production_check.friction_excess,
       production_check.friction_share,
       production_check.moving_samples,
       production_check.samples,
       CASE WHEN production_check.joint IS NULL THEN ifnull(cycle.reason, 'no model yet') END AS reason,
       production_check.estimator
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;

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
       warmup_fit.a_extrapolated,
       warmup_fit.c_first_nm,
       warmup_fit.c_first_std_error_nm,
       warmup_fit.t2_max_min
FROM warmup_fit
JOIN robot USING (robot_id);

DROP VIEW production_trend;

CREATE VIEW production_trend AS
SELECT robot.name AS robot,
       run.run_id,
       strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch') AS started_at,
       production_summary.joint,
       production_summary.reference_run_id,
       production_summary.windows,
       production_summary.relative_rmsd AS moving_relative_rmsd,
       production_summary.friction_excess,
       production_summary.friction_share,
       of_test.relative_rmsd AS test_relative_rmsd
FROM production_summary
JOIN run USING (run_id)
JOIN robot USING (robot_id)
LEFT JOIN run_joint_summary AS of_test
          ON of_test.run_id = production_summary.reference_run_id AND of_test.joint = production_summary.joint
WHERE run.superseded_by_run_id IS NULL;

-- Production was held against ordinary estimates of its tests, whatever was configured: it is settled again.
UPDATE robot SET history = history + 1
WHERE EXISTS (SELECT 1 FROM run WHERE run.robot_id = robot.robot_id AND run.kind = 'production');
