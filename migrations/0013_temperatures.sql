-- Temperatures where they were recorded, and what the thermal state of a friction map stands on.

-- Mean temperatures of a cycle, of those that were recorded and believed. Joint 0 is the hall.
CREATE TABLE cycle_temperature (
    cycle_id         INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 0),
    temperature_degc REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

-- What the thermal state of the joint is taken from. Maps stored before knew nothing but motion.
ALTER TABLE friction_law ADD COLUMN thermal_source TEXT NOT NULL DEFAULT 'motion'
    CHECK (thermal_source IN ('motion', 'motor_temperature', 'ambient_and_motion'));
-- Motor temperatures at which the slow part of coldness is 0 and 1; with source `motor_temperature` only.
ALTER TABLE friction_law ADD COLUMN warm_degc REAL;
ALTER TABLE friction_law ADD COLUMN cold_degc REAL;
-- How much steeper coldness is where it is cold, as viscosity has it; 0 is a line.
ALTER TABLE friction_law ADD COLUMN curvature REAL;
ALTER TABLE friction_law ADD COLUMN curvature_std_error REAL;
-- The usual temperature of the hall, and coldness for each kelvin below it; with source `ambient_and_motion` only.
ALTER TABLE friction_law ADD COLUMN ambient_degc REAL;
ALTER TABLE friction_law ADD COLUMN coldness_1_k REAL;
ALTER TABLE friction_law ADD COLUMN coldness_std_error_1_k REAL;

-- The contract -------------------------------------------------------------------------------------

CREATE VIEW temperatures AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       ((cycle.started_at - run.started_at) / 1000000.0 + 0.5 * cycle.duration_s) / 60.0 AS minute,
       iif(found.joint = 0, 'ambient', 'motor') AS sensor,
       nullif(found.joint, 0) AS joint,
       found.temperature_degc
FROM cycle_temperature AS found
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW friction_map;

CREATE VIEW friction_map AS
SELECT robot.name AS robot,
       law.joint,
       level.speed_fraction,
       level.warm_nm,
       level.warm_std_error_nm,
       level.cold_nm,
       level.cold_std_error_nm,
       iif(law.thermal_source = 'motor_temperature', NULL, law.slow_min) AS slow_min,
       iif(law.thermal_source = 'motor_temperature', NULL, law.slow_std_error_min) AS slow_std_error_min,
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
       law.remarks,
       law.thermal_source,
       law.warm_degc,
       law.cold_degc,
       law.curvature,
       law.curvature_std_error,
       law.ambient_degc,
       law.coldness_1_k,
       law.coldness_std_error_1_k
FROM friction_law AS law
JOIN friction_level AS level USING (robot_id, joint)
JOIN robot USING (robot_id);
