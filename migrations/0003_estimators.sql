-- How parameters were estimated, and how well they are known.

-- Cycles stored before this were identified by ordinary least squares.
ALTER TABLE cycle ADD COLUMN estimator TEXT NOT NULL DEFAULT 'ordinary'
    CHECK (estimator IN ('ordinary', 'weighted', 'huber'));

-- Of the standard error. NULL for parameters stored before: their errors were not made for intervals.
ALTER TABLE cycle_parameter ADD COLUMN degrees_of_freedom REAL;
ALTER TABLE parameter_set_value ADD COLUMN degrees_of_freedom REAL;

-- What identification left of each joint's torque.
CREATE TABLE joint_residual (
    cycle_id          INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint             INTEGER NOT NULL CHECK (joint >= 1),
    residual_std_nm   REAL,
    -- Independent rows over the joint's rows, for errors from factors alone. Above 1 where the noise is
    -- less at the frequencies of the motion than above them.
    independent_share REAL CHECK (independent_share > 0),
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

-- The contract -------------------------------------------------------------------------------------

DROP VIEW cycles;
CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
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
       cycle.estimator
FROM cycle
JOIN run USING (run_id)
JOIN robot USING (robot_id);

-- Student's quantile for 95 % is that of the normal distribution and a series in one over the degrees
-- of freedom (Abramowitz & Stegun 26.7.5), at least three of them, as the program takes it.
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
       cycle_parameter.value - cycle_parameter.half_width AS interval_low,
       cycle_parameter.value + cycle_parameter.half_width AS interval_high
FROM (
    SELECT cycle_id,
           model_parameter_id,
           value,
           std_error,
           degrees_of_freedom,
           std_error * (1.959964 + u * (2.372271 + u * (2.822499 + u * (2.555850 + u * 1.589534)))) AS half_width
    FROM (
        SELECT cycle_id,
               model_parameter_id,
               value,
               std_error,
               degrees_of_freedom,
               1.0 / max(degrees_of_freedom, 3.0) AS u
        FROM cycle_parameter
    )
) AS cycle_parameter
JOIN model_parameter USING (model_parameter_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW joint_residuals AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       joint_residual.joint,
       joint_residual.residual_std_nm,
       joint_residual.independent_share
FROM joint_residual
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
