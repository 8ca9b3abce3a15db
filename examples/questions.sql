-- Questions to the public views (docs/schema.md), one SQLite statement per question, sorted by reader. Statements have no
-- parameters: change the robot, run or number of days in the text. dashboards/ has longer queries with parameters.
--
--     sqlite3 -readonly -box armwatch.db          paste a statement, or .read this file
--     armwatch sql "SELECT ..."                   one statement
--
-- Views do not use the clock. Statements that depend on today use 'now'; for an archived database, replace it with a day
-- such as '2026-02-01'. Times are text that sorts in time order, so >= and ORDER BY work.

-- # For the technician

-- ## What is wrong now?
-- Alarms that are neither resolved nor false, worst first.
SELECT anomaly_id, robot, joint, severity, state, kind, onset_at, last_seen_at, message
FROM anomalies
WHERE state NOT IN ('resolved', 'false_alarm')
ORDER BY CASE severity WHEN 'critical' THEN 0 WHEN 'warning' THEN 1 ELSE 2 END, last_seen_at DESC;

-- ## Which robots need attention?
-- Robots with a joint that is neither ok nor learning.
SELECT robot,
       max(last_run_at) AS last_run_at,
       group_concat(CASE WHEN status = 'critical' THEN joint END, ', ') AS critical_joints,
       group_concat(CASE WHEN status = 'warning' THEN joint END, ', ') AS warning_joints,
       group_concat(CASE WHEN status = 'unknown' THEN joint END, ', ') AS unknown_joints,
       count(CASE WHEN status = 'overdue' THEN 1 END) AS overdue_joints
FROM fleet_health
WHERE status NOT IN ('ok', 'learning')
GROUP BY robot
ORDER BY count(CASE WHEN status = 'critical' THEN 1 END) DESC,
         count(CASE WHEN status = 'warning' THEN 1 END) DESC,
         robot;

-- ## What got worse this month?
-- Rise of the friction index over the 30 days before the robot's latest test, if it exceeds twice the combined standard
-- error; 0.1 is 10 % of the baseline friction.
WITH fleet AS (
    SELECT robot, max(last_run_at) AS latest_at FROM fleet_health GROUP BY robot
),
month AS MATERIALIZED (
    SELECT runs.robot, friction_index.joint, runs.started_at, friction_index.friction_index,
           friction_index.friction_index_std_error
    FROM fleet
    CROSS JOIN runs ON runs.robot = fleet.robot
             AND runs.started_at >= strftime('%Y-%m-%dT%H:%M:%fZ', fleet.latest_at, '-30 days')
    CROSS JOIN friction_index ON friction_index.run_id = runs.run_id
),
-- with min() or max(), SQLite takes the other columns from the same row
first AS (
    SELECT robot, joint, min(started_at) AS started_at, friction_index, friction_index_std_error
    FROM month GROUP BY robot, joint
),
last AS (
    SELECT robot, joint, max(started_at) AS started_at, friction_index, friction_index_std_error
    FROM month GROUP BY robot, joint
)
SELECT robot, joint, first.started_at AS compared_with, last.started_at AS latest,
       round(first.friction_index, 3) AS friction_index_then,
       round(last.friction_index, 3) AS friction_index_now,
       round(last.friction_index - first.friction_index, 3) AS rise
FROM first
JOIN last USING (robot, joint)
WHERE last.friction_index > first.friction_index
  AND (last.friction_index - first.friction_index) * (last.friction_index - first.friction_index)
      > 4 * (first.friction_index_std_error * first.friction_index_std_error
             + last.friction_index_std_error * last.friction_index_std_error)
ORDER BY rise DESC;

-- ## Which joints will reach the critical limit within 90 days?
-- Forecast with its 80 % interval.
SELECT robot, joint, friction_index, trend, critical_by, critical_by_lower, critical_by_upper
FROM fleet_health
WHERE critical_by BETWEEN date('now') AND date('now', '+90 days')
ORDER BY critical_by;

-- ## Which joints are on their way to a limit?
-- critical_by is NULL if the limit is passed or beyond the forecast horizon.
SELECT robot, joint, status, friction_index, trend, warning_by, critical_by
FROM fleet_health
WHERE trend IN ('rising', 'falling')
ORDER BY critical_by IS NULL, critical_by, warning_by IS NULL, warning_by;

-- ## Which robots have sent no test for a week?
-- By the start of the latest complete test; includes robots without one.
SELECT robot,
       max(CASE WHEN status = 'complete' AND kind = 'test' THEN started_at END) AS last_test_at,
       round(julianday('now')
             - julianday(max(CASE WHEN status = 'complete' AND kind = 'test' THEN started_at END)), 1) AS days_ago
FROM runs
GROUP BY robot
HAVING last_test_at IS NULL OR last_test_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', '-7 days')
ORDER BY last_test_at;

-- ## What did the repair change?
-- Mean friction after each maintenance divided by mean friction before it, over up to three tests on either side at equal
-- speed, direction and cycle. The friction index cannot show this, because maintenance resets it.
WITH side AS (
    SELECT maintenance_log.maintenance_id, maintenance_log.robot, maintenance_log.joint, maintenance_log.at,
           maintenance_log.what, test.run_id,
           CASE WHEN test.started_at < maintenance_log.at THEN 'before' ELSE 'after' END AS side,
           row_number() OVER (
               PARTITION BY maintenance_log.maintenance_id, test.started_at < maintenance_log.at
               ORDER BY abs(julianday(test.started_at) - julianday(maintenance_log.at))
           ) AS place
    FROM maintenance_log
    CROSS JOIN runs AS test ON test.robot = maintenance_log.robot AND test.status = 'complete' AND test.kind = 'test'
),
point AS (
    SELECT side.maintenance_id, friction_points.joint, friction_points.cycle, friction_points.speed_fraction,
           friction_points.direction,
           avg(CASE WHEN side.side = 'before' THEN abs(friction_points.torque_nm) END) AS before_nm,
           avg(CASE WHEN side.side = 'after' THEN abs(friction_points.torque_nm) END) AS after_nm
    FROM side
    CROSS JOIN friction_points ON friction_points.run_id = side.run_id
                              AND (side.joint IS NULL OR friction_points.joint = side.joint)
    WHERE side.place <= 3
    GROUP BY side.maintenance_id, friction_points.joint, friction_points.cycle, friction_points.speed_fraction,
             friction_points.direction
)
SELECT maintenance_log.maintenance_id, maintenance_log.robot, point.joint, maintenance_log.at, maintenance_log.what,
       round(avg(point.before_nm), 3) AS friction_before_nm,
       round(avg(point.after_nm), 3) AS friction_after_nm,
       round(avg(point.after_nm / point.before_nm), 3) AS ratio,
       count(*) AS points
FROM point
JOIN maintenance_log USING (maintenance_id)
WHERE point.before_nm > 0 AND point.after_nm IS NOT NULL
GROUP BY maintenance_log.maintenance_id, point.joint
ORDER BY maintenance_log.at DESC, point.joint;

-- ## When did it begin, and which test showed it first?
-- Exports of onset, first and latest test of each alarm that is neither resolved nor false.
SELECT anomalies.anomaly_id, anomalies.robot, anomalies.joint, anomalies.kind,
       anomalies.onset_at, began.source_name AS began_with,
       anomalies.first_seen_at, shown.source_name AS first_shown_by,
       anomalies.last_seen_at, latest.source_name AS last_shown_by
FROM anomalies
LEFT JOIN runs AS began ON began.run_id = anomalies.onset_run_id
LEFT JOIN runs AS shown ON shown.run_id = anomalies.run_id
LEFT JOIN runs AS latest ON latest.run_id = anomalies.last_run_id
WHERE anomalies.state NOT IN ('resolved', 'false_alarm')
ORDER BY anomalies.onset_at;

-- ## What happened to alarm 1?
SELECT at, what, severity, value, message, who, why
FROM anomaly_history
WHERE anomaly_id = 1
ORDER BY anomaly_event_id;

-- ## Which cycles were refused, and why?
SELECT cycles.robot, cycles.reason, count(*) AS refused_cycles, count(DISTINCT cycles.run_id) AS tests,
       max(cycles.started_at) AS last_at
FROM cycles
CROSS JOIN runs ON runs.run_id = cycles.run_id
WHERE cycles.status = 'refused' AND runs.kind = 'test' AND runs.status = 'complete'
GROUP BY cycles.robot, cycles.reason
ORDER BY refused_cycles DESC, last_at DESC;

-- ## Which exports are in quarantine, and where is the fault?
SELECT run_id, robot, source_path, problem, line, column_name, value, remedy, tries, first_at
FROM quarantine
WHERE state = 'open'
ORDER BY first_at DESC;

-- # For the robotics engineer

-- ## How did friction of one joint develop?
-- Friction index of joint 3 of Middle with its 95 % interval; 1 is the baseline.
SELECT started_at, run_id,
       round(friction_index, 4) AS friction_index,
       round(friction_index - 1.96 * friction_index_std_error, 4) AS interval_low,
       round(friction_index + 1.96 * friction_index_std_error, 4) AS interval_high,
       round(raw_index, 4) AS raw_index
FROM friction_index
WHERE robot = 'Middle' AND joint = 3
ORDER BY started_at;

-- ## How noisy is each joint's friction index?
-- Standard deviation of Middle's index from test to test, without slow trends, and the stated standard error.
WITH step AS (
    SELECT robot, joint, friction_index_std_error,
           friction_index - lag(friction_index) OVER (PARTITION BY joint ORDER BY started_at, run_id) AS change
    FROM friction_index
    WHERE robot = 'Middle' AND short_run = 0
)
SELECT robot, joint,
       count(change) AS differences,
       -- the mean absolute difference of two such values is 1.128 standard deviations
       round(0.8862 * avg(abs(change)), 5) AS scatter,
       round(avg(friction_index_std_error), 5) AS stated_std_error
FROM step
GROUP BY robot, joint
HAVING count(change) >= 3
ORDER BY scatter DESC;

-- ## Which arms differ from their twins?
-- Warm friction at 60 % of each joint's largest speed, compared with the mean of the other arms of its model.
WITH arm AS (
    SELECT robot,
           (SELECT model FROM runs
            WHERE runs.robot = mapped.robot AND runs.status = 'complete' AND runs.kind <> 'production'
            ORDER BY runs.started_at DESC LIMIT 1) AS model
    FROM (SELECT DISTINCT robot FROM friction_map) AS mapped
),
level AS (
    SELECT arm.model, friction_map.robot, friction_map.joint, friction_map.warm_nm,
           count(*) OVER twins - 1 AS others,
           sum(friction_map.warm_nm) OVER twins - friction_map.warm_nm AS sum_of_others_nm
    FROM friction_map
    JOIN arm USING (robot)
    WHERE abs(friction_map.speed_fraction - 0.6) < 0.001
    WINDOW twins AS (PARTITION BY arm.model, friction_map.joint)
)
SELECT model, robot, joint,
       round(warm_nm, 3) AS warm_nm,
       round(sum_of_others_nm / others, 3) AS mean_of_others_nm,
       round(warm_nm * others / sum_of_others_nm, 3) AS ratio,
       others
FROM level
WHERE others >= 2
ORDER BY abs(warm_nm * others / sum_of_others_nm - 1) DESC;

-- ## How did RMSD develop?
-- Mean moving relative RMSD of Middle's excitation stages over the 90 days before its latest test, and its change since the
-- first of these tests.
WITH span AS (
    SELECT strftime('%Y-%m-%dT%H:%M:%fZ', max(last_run_at), '-90 days') AS since FROM fleet_health WHERE robot = 'Middle'
),
of_test AS (
    SELECT runs.robot, runs.run_id, runs.started_at, cycle_rmsd.joint,
           avg(cycle_rmsd.moving_relative_rmsd) AS rmsd,
           max(cycle_rmsd.moving_relative_rmsd) AS worst_cycle
    FROM runs
    CROSS JOIN cycle_rmsd ON cycle_rmsd.run_id = runs.run_id
    WHERE runs.robot = 'Middle' AND runs.started_at >= (SELECT since FROM span)
      AND runs.status = 'complete' AND runs.kind = 'test'
      AND cycle_rmsd.stage = 'excitation' AND cycle_rmsd.verification = 'self'
    GROUP BY runs.run_id, cycle_rmsd.joint
)
SELECT robot, joint, started_at, run_id,
       round(rmsd, 4) AS moving_relative_rmsd,
       round(worst_cycle, 4) AS worst_cycle,
       round(rmsd - first_value(rmsd) OVER (PARTITION BY joint ORDER BY started_at, run_id), 4) AS change
FROM of_test
ORDER BY joint, started_at;

-- ## Which stage does the model explain worst?
-- Middle's latest five tests. A high RMSD in one stage points to an effect that the model lacks.
WITH latest AS (
    SELECT run_id, robot FROM runs
    WHERE robot = 'Middle' AND status = 'complete' AND kind = 'test'
    ORDER BY started_at DESC, run_id DESC
    LIMIT 5
)
SELECT cycle_rmsd.joint, cycle_rmsd.stage,
       round(avg(cycle_rmsd.moving_rmsd_nm), 3) AS moving_rmsd_nm,
       round(avg(cycle_rmsd.moving_relative_rmsd), 4) AS moving_relative_rmsd,
       count(*) AS cycles
FROM latest
CROSS JOIN cycle_rmsd ON cycle_rmsd.run_id = latest.run_id
WHERE cycle_rmsd.verification = 'self' AND cycle_rmsd.stage <> 'all'
GROUP BY cycle_rmsd.joint, cycle_rmsd.stage
ORDER BY cycle_rmsd.joint, moving_relative_rmsd DESC;

-- ## How high is friction at 60 % speed, cold and warm?
-- Mean of both directions in the first and last cycle of each robot's latest complete test.
WITH latest AS (
    SELECT (SELECT run_id FROM runs
            WHERE runs.robot = fleet.robot AND status = 'complete' AND kind = 'test'
            ORDER BY started_at DESC, run_id DESC LIMIT 1) AS run_id
    FROM (SELECT DISTINCT robot FROM fleet_health) AS fleet
),
point AS (
    SELECT runs.robot, runs.started_at, friction_points.joint, friction_points.cycle,
           avg(abs(friction_points.torque_nm)) AS friction_nm,
           avg(friction_points.minute) AS minute,
           min(friction_points.cycle) OVER (PARTITION BY runs.robot, friction_points.joint) AS first_cycle,
           max(friction_points.cycle) OVER (PARTITION BY runs.robot, friction_points.joint) AS last_cycle
    FROM latest
    CROSS JOIN runs ON runs.run_id = latest.run_id
    CROSS JOIN friction_points ON friction_points.run_id = latest.run_id
    WHERE abs(friction_points.speed_fraction - 0.6) < 0.001
    GROUP BY runs.robot, runs.started_at, friction_points.joint, friction_points.cycle
    HAVING count(DISTINCT friction_points.direction) = 2
)
SELECT robot, joint, started_at,
       round(max(CASE WHEN cycle = first_cycle THEN friction_nm END), 3) AS cold_nm,
       round(max(CASE WHEN cycle = first_cycle THEN minute END), 1) AS cold_minute,
       round(max(CASE WHEN cycle = last_cycle THEN friction_nm END), 3) AS warm_nm,
       round(max(CASE WHEN cycle = last_cycle THEN minute END), 1) AS warm_minute
FROM point
GROUP BY robot, joint, started_at
ORDER BY robot, joint;

-- ## How long does warming up take?
-- Time constants, and minutes of motion until 5 % of the slow part is left (three time constants).
SELECT DISTINCT robot, joint,
       round(slow_min, 1) AS slow_min,
       round(slow_std_error_min, 1) AS slow_std_error_min,
       round(fast_min, 1) AS fast_min,
       round(slow_share, 2) AS slow_share,
       round(3 * slow_min, 0) AS warm_after_min,
       round(cooling_ratio * slow_min, 0) AS cooling_min,
       runs
FROM friction_map
ORDER BY robot, joint;

-- ## How does friction depend on speed?
SELECT robot, joint, speed_fraction,
       round(warm_nm, 3) AS warm_nm,
       round(warm_nm + cold_nm, 3) AS cold_nm,
       round((warm_nm + cold_nm) / nullif(warm_nm, 0), 2) AS cold_over_warm
FROM friction_map
WHERE robot = 'Middle'
ORDER BY joint, speed_fraction;

-- ## Which parameters changed most since the first five tests?
-- Middle's latest test against its first five, in multiples of their mean absolute deviation, without the cold cycles
-- 1 to 5.
WITH test AS (
    SELECT * FROM (SELECT run_id, robot, 'first' AS which FROM runs
                   WHERE robot = 'Middle' AND status = 'complete' AND kind = 'test'
                   ORDER BY started_at, run_id LIMIT 5)
    UNION ALL
    SELECT * FROM (SELECT run_id, robot, 'latest' FROM runs
                   WHERE robot = 'Middle' AND status = 'complete' AND kind = 'test'
                   ORDER BY started_at DESC, run_id DESC LIMIT 1)
),
of_test AS (
    SELECT test.robot, test.which, statistics.joint, statistics.parameter, statistics.mean
    FROM test
    CROSS JOIN parameter_statistics AS statistics ON statistics.run_id = test.run_id
    WHERE statistics."window" = 'after_5'
),
baseline AS (
    SELECT joint, parameter, avg(mean) AS mean
    FROM of_test
    WHERE which = 'first'
    GROUP BY joint, parameter
    HAVING count(*) = 5
),
spread AS (
    SELECT of_test.joint, of_test.parameter, avg(abs(of_test.mean - baseline.mean)) AS deviation
    FROM of_test
    JOIN baseline USING (joint, parameter)
    WHERE of_test.which = 'first'
    GROUP BY of_test.joint, of_test.parameter
)
SELECT of_test.robot, of_test.joint, of_test.parameter,
       round(baseline.mean, 5) AS first_five,
       round(of_test.mean, 5) AS latest,
       round(of_test.mean / nullif(baseline.mean, 0) - 1, 4) AS relative_change,
       round(abs(of_test.mean - baseline.mean) / nullif(spread.deviation, 0), 1) AS multiples_of_deviation
FROM of_test
JOIN baseline USING (joint, parameter)
JOIN spread USING (joint, parameter)
WHERE of_test.which = 'latest'
ORDER BY multiples_of_deviation DESC
LIMIT 20;

-- ## Which parameters does the motion not show?
-- Standard errors above half the value in most cycles of Middle's latest five tests.
WITH latest AS (
    SELECT run_id, robot FROM runs
    WHERE robot = 'Middle' AND status = 'complete' AND kind = 'test'
    ORDER BY started_at DESC, run_id DESC
    LIMIT 5
)
SELECT latest.robot, cycle_parameters.joint, cycle_parameters.parameter, cycle_parameters.unit,
       round(avg(cycle_parameters.value), 5) AS mean_value,
       round(avg(cycle_parameters.std_error), 5) AS mean_std_error,
       round(avg(CASE WHEN cycle_parameters.relative_std_error > 0.5 THEN 1.0 ELSE 0.0 END), 2) AS share_of_cycles
FROM latest
CROSS JOIN cycle_parameters ON cycle_parameters.run_id = latest.run_id
GROUP BY latest.robot, cycle_parameters.joint, cycle_parameters.parameter, cycle_parameters.unit
HAVING share_of_cycles > 0.5
ORDER BY share_of_cycles DESC, cycle_parameters.joint;

-- ## Does the torque signal of a joint drift?
-- Plateau torque that does not change sign with the motion, in the first and latest test. A change is a torque offset or a
-- load.
WITH test AS (
    SELECT (SELECT run_id FROM runs
            WHERE runs.robot = fleet.robot AND status = 'complete' AND kind = 'test'
            ORDER BY started_at, run_id LIMIT 1) AS first_run_id,
           (SELECT run_id FROM runs
            WHERE runs.robot = fleet.robot AND status = 'complete' AND kind = 'test'
            ORDER BY started_at DESC, run_id DESC LIMIT 1) AS latest_run_id
    FROM (SELECT DISTINCT robot FROM fleet_health) AS fleet
),
first AS (
    SELECT cycle_friction.run_id, cycle_friction.robot, cycle_friction.joint, avg(cycle_friction.offset_nm) AS offset_nm
    FROM test CROSS JOIN cycle_friction ON cycle_friction.run_id = test.first_run_id
    GROUP BY cycle_friction.run_id, cycle_friction.joint
),
latest AS (
    SELECT test.first_run_id, cycle_friction.joint, avg(cycle_friction.offset_nm) AS offset_nm
    FROM test CROSS JOIN cycle_friction ON cycle_friction.run_id = test.latest_run_id
    GROUP BY cycle_friction.run_id, cycle_friction.joint
)
SELECT first.robot, first.joint,
       round(first.offset_nm, 4) AS first_offset_nm,
       round(latest.offset_nm, 4) AS latest_offset_nm,
       round(latest.offset_nm - first.offset_nm, 4) AS change_nm
FROM first
JOIN latest ON latest.first_run_id = first.run_id AND latest.joint = first.joint
ORDER BY abs(latest.offset_nm - first.offset_nm) DESC;

-- ## Does friction follow the temperature?
-- By cycle in Middle's latest 30 tests, if motor temperatures are recorded.
WITH test AS (
    SELECT run_id, started_at FROM runs
    WHERE robot = 'Middle' AND status = 'complete' AND kind = 'test'
    ORDER BY started_at DESC LIMIT 30
)
SELECT temperatures.robot, temperatures.run_id, temperatures.cycle, temperatures.joint,
       round(temperatures.temperature_degc, 1) AS motor_degc,
       round(avg(abs(friction_points.torque_nm)), 3) AS friction_nm,
       count(*) AS points
FROM test
CROSS JOIN temperatures ON temperatures.run_id = test.run_id
CROSS JOIN friction_points ON friction_points.run_id = temperatures.run_id
                         AND friction_points.cycle = temperatures.cycle AND friction_points.joint = temperatures.joint
WHERE temperatures.sensor = 'motor'
GROUP BY temperatures.robot, temperatures.run_id, temperatures.cycle, temperatures.joint
ORDER BY temperatures.joint, test.started_at, temperatures.cycle;

-- ## How does production compare with the test?
-- Excess friction over the reference test and fit of its parameters, in each robot's latest 200 production logs.
WITH log AS (
    SELECT run_id
    FROM (SELECT DISTINCT robot FROM fleet_health) AS fleet
    CROSS JOIN runs ON runs.robot = fleet.robot
    WHERE runs.status = 'complete' AND runs.kind = 'production'
          AND runs.started_at >= coalesce(
              (SELECT started_at FROM runs AS earlier
               WHERE earlier.robot = fleet.robot AND earlier.status = 'complete' AND earlier.kind = 'production'
               ORDER BY started_at DESC LIMIT 1 OFFSET 199), '')
)
SELECT robot, joint, started_at, log.run_id, reference_run_id, windows,
       round(friction_excess, 4) AS friction_excess,
       round(moving_relative_rmsd, 4) AS moving_relative_rmsd,
       round(test_relative_rmsd, 4) AS test_relative_rmsd,
       round(moving_relative_rmsd / nullif(test_relative_rmsd, 0), 2) AS times_the_test
FROM log CROSS JOIN production_trend ON production_trend.run_id = log.run_id
ORDER BY robot, joint, started_at;

-- ## Which production windows fit the test worst?
-- The 20 largest deviations in the latest 30 days of each robot.
WITH log AS (
    SELECT run_id
    FROM (SELECT DISTINCT robot FROM fleet_health) AS fleet
    CROSS JOIN runs ON runs.robot = fleet.robot
    WHERE runs.kind = 'production'
          AND runs.started_at >= strftime('%Y-%m-%dT%H:%M:%fZ', (SELECT max(started_at) FROM runs AS latest
                                                                 WHERE latest.robot = fleet.robot), '-30 days')
)
SELECT robot, log.run_id, cycle AS window_number, started_at, joint,
       round(moving_relative_rmsd, 4) AS moving_relative_rmsd,
       round(moving_rmsd_nm, 3) AS moving_rmsd_nm,
       round(friction_excess, 4) AS friction_excess,
       moving_samples
FROM log CROSS JOIN production_checks ON production_checks.run_id = log.run_id
WHERE joint IS NOT NULL
ORDER BY moving_relative_rmsd DESC
LIMIT 20;

-- # For the data engineer

-- ## How many false alarms were there by kind?
SELECT kind,
       count(*) AS episodes,
       count(CASE WHEN state = 'false_alarm' THEN 1 END) AS false_alarms,
       round(avg(CASE WHEN state = 'false_alarm' THEN 1.0 ELSE 0.0 END), 3) AS share
FROM anomalies
GROUP BY kind
ORDER BY false_alarms DESC, kind;

-- ## How long do alarms wait for an answer?
-- Hours from opening to the first action of a person, by severity. Alarms without an action are counted but not averaged.
WITH opened AS (
    SELECT anomaly_id, severity, min(at) AS at
    FROM anomaly_history
    WHERE what = 'opened'
    GROUP BY anomaly_id
),
acted AS (
    SELECT anomaly_id, min(at) AS at FROM anomaly_history WHERE who IS NOT NULL GROUP BY anomaly_id
)
SELECT opened.severity,
       count(*) AS alarms,
       count(acted.at) AS acted_on,
       round(avg(24 * (julianday(acted.at) - julianday(opened.at))), 2) AS mean_hours,
       round(max(24 * (julianday(acted.at) - julianday(opened.at))), 2) AS longest_hours
FROM opened
LEFT JOIN acted USING (anomaly_id)
GROUP BY opened.severity
ORDER BY opened.severity;

-- ## How many tests arrive each week, and how many give a result?
-- The latest four weeks by start of the test.
WITH span AS (
    SELECT strftime('%Y-%m-%dT%H:%M:%fZ', max(started_at), '-28 days') AS since FROM runs
),
test AS (
    SELECT run_id, started_at, status FROM runs WHERE kind = 'test' AND started_at >= (SELECT since FROM span)
),
counted AS MATERIALIZED (
    SELECT started_at, status,
           (SELECT count(*) FROM cycles WHERE cycles.run_id = test.run_id AND status = 'complete') AS good_cycles,
           (SELECT count(*) FROM cycles WHERE cycles.run_id = test.run_id AND status = 'refused') AS refused_cycles
    FROM test
)
SELECT strftime('%Y-%W', started_at) AS week,
       count(CASE WHEN status = 'complete' THEN 1 END) AS complete_tests,
       count(CASE WHEN status = 'complete' AND good_cycles = 0 THEN 1 END) AS without_result,
       count(CASE WHEN status = 'quarantined' THEN 1 END) AS in_quarantine,
       sum(good_cycles) AS good_cycles,
       sum(refused_cycles) AS refused_cycles
FROM counted
GROUP BY week
ORDER BY week;

-- ## Which cycles have remarks?
-- The latest 50 cycles with a remark or doubt.
SELECT robot, run_id, cycle, started_at, status, remarks
FROM cycles
WHERE remarks IS NOT NULL OR status = 'doubtful'
ORDER BY started_at DESC
LIMIT 50;

-- ## Which complete tests have no friction index?
-- Joints of each robot's latest test with friction points but no index: too few cycles, no baseline yet, or points that do
-- not show wear.
WITH latest AS (
    SELECT (SELECT run_id FROM runs
            WHERE runs.robot = fleet.robot AND status = 'complete' AND kind = 'test'
            ORDER BY started_at DESC, run_id DESC LIMIT 1) AS run_id
    FROM (SELECT DISTINCT robot FROM fleet_health) AS fleet
),
of_test AS (
    SELECT cycle_friction.robot, cycle_friction.run_id, cycle_friction.joint, count(*) AS cycles
    FROM latest CROSS JOIN cycle_friction ON cycle_friction.run_id = latest.run_id
    GROUP BY cycle_friction.run_id, cycle_friction.joint
)
SELECT of_test.robot, of_test.run_id, of_test.joint, of_test.cycles
FROM of_test
WHERE NOT EXISTS (SELECT 1 FROM friction_index
                  WHERE friction_index.run_id = of_test.run_id AND friction_index.joint = of_test.joint)
ORDER BY of_test.robot, of_test.joint;

-- ## Did the recording change?
-- Robots whose complete tests differ in sample rate or number of cycles.
SELECT robot,
       count(*) AS tests,
       min(sample_rate_hz) AS lowest_rate_hz,
       max(sample_rate_hz) AS highest_rate_hz,
       min(cycles) AS fewest_cycles,
       max(cycles) AS most_cycles,
       sum(rows_skipped) AS rows_skipped
FROM runs
WHERE status = 'complete' AND kind = 'test'
GROUP BY robot
HAVING max(sample_rate_hz) - min(sample_rate_hz) > 0.01 * max(sample_rate_hz) OR min(cycles) <> max(cycles)
ORDER BY robot;

-- ## Which baseline does each joint have?
SELECT robot, joint, epoch, cause, begins_at,
       count(*) AS tests,
       min(started_at) AS first_test_at,
       max(started_at) AS last_test_at,
       max(remark) AS remark
FROM baselines
GROUP BY robot, joint, epoch, cause, begins_at
ORDER BY robot, joint, epoch;

-- ## Which alarms did not reach their receiver?
SELECT route, state, robot, joint, what, severity, due_at, attempts, attempted_at, error
FROM deliveries
WHERE state IN ('pending', 'failed')
ORDER BY due_at;

-- ## Which robots have no new conclusions?
-- Robots whose analysis fails.
SELECT robot, first_at AS since, last_at AS latest_attempt, tries, reason
FROM conclusion_faults
ORDER BY first_at;

-- ## Everything about a test, one row per joint
-- Friction and RMSD of Middle's complete tests in the 90 days before its latest test, for training or plots. For all robots
-- and years, use armwatch export --parquet DIR --by-month and a columnar engine.
WITH test AS (
    SELECT run_id, robot, started_at FROM runs
    WHERE robot = 'Middle' AND status = 'complete' AND kind = 'test'
      AND started_at >= (SELECT strftime('%Y-%m-%dT%H:%M:%fZ', max(last_run_at), '-90 days')
                         FROM fleet_health WHERE robot = 'Middle')
),
rmsd AS (
    SELECT test.run_id, cycle_rmsd.joint, avg(moving_relative_rmsd) AS moving_relative_rmsd, count(*) AS cycles
    FROM test CROSS JOIN cycle_rmsd ON cycle_rmsd.run_id = test.run_id
    WHERE stage = 'excitation' AND verification = 'self'
    GROUP BY test.run_id, cycle_rmsd.joint
),
friction AS (
    SELECT test.run_id, friction_points.joint, avg(abs(torque_nm)) AS friction_nm
    FROM test CROSS JOIN friction_points ON friction_points.run_id = test.run_id
    WHERE abs(speed_fraction - 0.6) < 0.001
    GROUP BY test.run_id, friction_points.joint
),
compared AS (
    SELECT friction_index.* FROM test CROSS JOIN friction_index ON friction_index.run_id = test.run_id
)
SELECT test.robot, test.run_id, test.started_at, rmsd.joint, rmsd.cycles,
       rmsd.moving_relative_rmsd,
       friction.friction_nm,
       compared.friction_index,
       compared.friction_index_std_error,
       compared.coldness_at_start
FROM test
JOIN rmsd USING (run_id)
LEFT JOIN friction ON friction.run_id = rmsd.run_id AND friction.joint = rmsd.joint
LEFT JOIN compared ON compared.run_id = rmsd.run_id AND compared.joint = rmsd.joint
ORDER BY test.started_at, rmsd.joint;
