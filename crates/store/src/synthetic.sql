-- A history that nobody recorded, for measurements of the time that questions about a long one take: `:robots` robots of
-- `:runs` tests each with `:cycles` cycles and six joints, one test a day from 2020 on, their files in the folder `:inbox`.
-- Figures are near one another and stand for nothing. Of the tests, counted from 0 over all robots, day by day, those from
-- `:first` to before `:last`. Behind each test are `:logs` logs of production of a window each, the keys of whose runs
-- and cycles follow those of all `:runs` tests; `:evidence` is what such a log leaves of the torque, as it is stored. Where there are logs,
-- cycles of tests have factors for 120 days and windows for 7, as far as questions ask whether there are some.
CREATE TEMP TABLE size (robots INTEGER, cycles INTEGER, joints INTEGER);
INSERT INTO size VALUES (:robots, :cycles, 6);
CREATE TEMP TABLE of_run (run_id INTEGER PRIMARY KEY, robot INTEGER, at INTEGER);
INSERT INTO of_run WITH RECURSIVE n (k) AS (SELECT :first UNION ALL SELECT k + 1 FROM n WHERE k + 1 < :last)
    SELECT k + 1, k % robots + 1, k / robots FROM n, size;
CREATE TEMP TABLE of_cycle (cycle_id INTEGER PRIMARY KEY, run_id INTEGER, number INTEGER);
INSERT INTO of_cycle WITH RECURSIVE c (number) AS (SELECT 1 UNION ALL SELECT number + 1 FROM c, size WHERE number <
    cycles) SELECT (run_id - 1) * cycles + number, run_id, number FROM of_run CROSS JOIN c CROSS JOIN size;
CREATE TEMP TABLE joints (joint INTEGER PRIMARY KEY);
INSERT INTO joints WITH RECURSIVE j (joint) AS (SELECT 1 UNION ALL SELECT joint + 1 FROM j, size WHERE joint < joints)
    SELECT joint FROM j;
INSERT OR IGNORE INTO robot (robot_id, name, history, concluded) SELECT DISTINCT robot, format('S%03d', robot), 1, 1 FROM of_run;
INSERT OR IGNORE INTO robot_model VALUES (1, 'er3a', zeroblob(32));
INSERT OR IGNORE INTO model_parameter (robot_model_id, joint, name, unit, grouping) SELECT 1, joint, name, 'x', format('J%d_%s',
    joint, name) FROM joints, (SELECT 'Izz' AS name UNION ALL SELECT 'mPx' UNION ALL SELECT 'mPy' UNION ALL SELECT
    'Ixx' UNION ALL SELECT 'f1' UNION ALL SELECT 'f2');
INSERT INTO run (run_id, robot_id, model, robot_model_id, started_at, source_name, source_path, source_bytes,
    content_hash, rows, sample_rate_hz, cycles_stored, cycles_total, status, figures_hash, device, inode, ingested_at)
    SELECT run_id, robot, 'er3a', 1, 1577836800000000 + at * 86400000000, format('S%03d_%06d.csv', robot, at),
    ':inbox/' || format('S%03d_%06d.csv', robot, at), 1000, CAST(format('%032d', run_id) AS BLOB), 1000, 250.0, cycles,
    cycles, 'complete', zeroblob(32), 1, run_id, 1 FROM of_run, size;
INSERT INTO source_file SELECT source_path, 1000, 1, run_id FROM run JOIN of_run USING (run_id) ORDER BY 1;
INSERT INTO cycle (cycle_id, run_id, number, started_at, duration_s, rows, sample_rate_hz, cutoff_hz, status, samples,
    condition_number, scaled_condition_number, residual_std_nm, estimator, mean_speeds_rad_s) SELECT cycle_id,
    of_cycle.run_id, number, run.started_at + number * 300000000, 290.0, 72500, 250.0, 10.0, 'complete', 2000, 30.0,
    5.0, 0.1, 'weighted', '[0.5,0.5,0.5,0.5,0.5,0.5]' FROM of_cycle JOIN run USING (run_id) ORDER BY cycle_id;
INSERT INTO torque_rmsd (cycle_id, joint, stage, verification, rmsd_nm, relative_rmsd, moving_rmsd_nm,
    moving_relative_rmsd, samples, moving_samples, estimator) SELECT cycle_id, joint, stage, 'self', 0.1, 0.1, 0.1,
    0.05 + (cycle_id * 7919 % 1000) * 1e-6, 2000, 1500, 'weighted' FROM of_cycle CROSS JOIN (SELECT 'all' AS stage
    UNION ALL SELECT 'excitation') CROSS JOIN joints;
INSERT INTO friction_point SELECT cycle_id, level, joint, joint, number * 300.0, 0.5 * level, 1, 1.0, 0.01, 200,
    'model', NULL, NULL FROM of_cycle CROSS JOIN (SELECT 0.6 AS level UNION ALL SELECT 1.0) CROSS JOIN joints;
INSERT INTO cycle_friction_level SELECT cycle_id, joint, number * 5.0, (cycle_id * 104729 % 1000) * 1e-5, 0.0, 2, 0.8
    FROM of_cycle CROSS JOIN joints;
INSERT INTO cycle_parameter (cycle_id, model_parameter_id, value, std_error) SELECT cycle_id, model_parameter_id, 1.0,
    0.01 FROM of_cycle CROSS JOIN model_parameter;
INSERT INTO run_joint_summary SELECT run_id, joint, 1.0, 0.01, 60.0, 1.0, 0.05 + (run_id * 7919 % 1000) * 1e-6, 0.001,
    24, 'weighted', 1.0, 0.01, 60.0, 1.0, 0.03, 12.0, 0.9, 0.02 FROM of_run CROSS JOIN joints;
INSERT INTO run_friction SELECT run_id, zeroblob(32) FROM of_run;
INSERT INTO run_friction_points SELECT run_id, joint, 96 FROM of_run CROSS JOIN joints;
INSERT INTO run_friction_index SELECT run_id, joint, 1 + (run_id * 7919 % 1000) * 1e-5, 0.005, 0.0, 0.01, 0.0, 96,
    1.0, 0 FROM of_run CROSS JOIN joints;
INSERT INTO parameter_statistic SELECT run_id, model_parameter_id, w, 1.0, 0.9, 1.1, 0.1, 0.1, 0.01, cycles FROM
    of_run CROSS JOIN model_parameter CROSS JOIN (SELECT 'after_5' AS w UNION ALL SELECT 'all') CROSS JOIN size;
CREATE TEMP TABLE of_log (run_id INTEGER PRIMARY KEY, cycle_id INTEGER, test INTEGER, robot INTEGER, at INTEGER, started_at INTEGER);
INSERT INTO of_log WITH RECURSIVE n (k) AS (SELECT 1 WHERE :logs > 0 UNION ALL SELECT k + 1 FROM n WHERE k < :logs)
    SELECT :runs + (run_id - 1) * :logs + k, :runs * cycles + (run_id - 1) * :logs + k, run_id, robot, at,
    1577836800000000 + at * 86400000000 + k * 86400000000 / (:logs + 1) FROM of_run CROSS JOIN n CROSS JOIN size;
INSERT INTO run (run_id, robot_id, model, robot_model_id, started_at, source_name, source_path, source_bytes,
    content_hash, rows, sample_rate_hz, cycles_stored, cycles_total, status, kind, ingested_at)
    SELECT run_id, robot, 'er3a', 1, started_at, format('S%03d_%06d_%02d.csv', robot, at, run_id % :logs), ':inbox/' ||
    format('S%03d_%06d_%02d.csv', robot, at, run_id % :logs), 1000, CAST(format('%032d', run_id) AS BLOB), 1000, 250.0,
    1, 1, 'complete', 'production', 1 FROM of_log;
INSERT OR IGNORE INTO factor_layout SELECT 1, 1, '[]' WHERE :logs > 0;
INSERT INTO cycle (cycle_id, run_id, number, started_at, duration_s, rows, sample_rate_hz, cutoff_hz, status, samples,
    estimator, factors_gone) SELECT cycle_id, run_id, 1, started_at, 290.0, 72500, 250.0, 10.0, 'complete', 2000,
    'weighted', CASE WHEN at < :runs / robots - 7 THEN 'joined' END FROM of_log CROSS JOIN size;
INSERT INTO cycle_factor_layout SELECT cycle_id, 1 FROM of_log CROSS JOIN size WHERE at >= :runs / robots - 7;
UPDATE cycle SET factors_gone = 'removed' FROM of_cycle JOIN of_run USING (run_id) CROSS JOIN size
    WHERE cycle.cycle_id = of_cycle.cycle_id AND :logs > 0 AND at < :runs / robots - 120;
INSERT INTO cycle_factor_layout SELECT cycle_id, 1 FROM of_cycle JOIN of_run USING (run_id) CROSS JOIN size
    WHERE :logs > 0 AND at >= :runs / robots - 120;
INSERT INTO production_check (cycle_id, joint, reference_run_id, moving_relative_rmsd, samples, moving_samples,
    friction_excess, friction_share, settled, estimator) SELECT cycle_id, joint, test, 0.06 + (cycle_id * 7919 % 1000) *
    1e-6, 2000, 1500, (cycle_id * 104729 % 1000) * 1e-5, 0.1, 1, 'weighted' FROM of_log CROSS JOIN joints;
INSERT INTO production_summary SELECT run_id, test, joint, 1, 0.06 + (cycle_id * 7919 % 1000) * 1e-6, (cycle_id * 104729
    % 1000) * 1e-5, 0.1 FROM of_log CROSS JOIN joints;
INSERT INTO log_evidence SELECT run_id, test, :evidence FROM of_log;
DROP TABLE temp.of_log;
DROP TABLE temp.size;
DROP TABLE temp.of_run;
DROP TABLE temp.of_cycle;
DROP TABLE temp.joints;
