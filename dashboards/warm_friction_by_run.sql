-- How does warm friction of each joint develop, for runs and robots without a friction index? warm_friction_ratio is warm
-- friction divided by the joint's own baseline, 1 = unchanged. The friction index (friction_index_by_run.sql) compares at
-- equal thermal state and scatters less.
--
-- Warm friction is the mean over both directions of the friction on the plateaus nearest the reference speed, in the last
-- third of a run's cycles. The baseline is the median of the joint's first runs. A ratio is given only for runs that were
-- about as warm as these (time of the warm points within 25 %). Detectors and fleet_health use it for a joint without a row
-- in the view friction_index.
--
--   :robot            a robot; default: the one tested last
--   :joint            only this joint; default: all
--   :speed_fraction   reference speed, as in the configuration; default: 0.6
--   :baseline_runs    runs of the baseline, as in the configuration; default: 5
WITH chosen AS (
    SELECT coalesce(nullif(:robot, ''),
                    (SELECT robot FROM runs WHERE status = 'complete' ORDER BY started_at DESC LIMIT 1)) AS robot,
           CAST(nullif(:joint, '') AS INTEGER) AS joint,
           CAST(coalesce(nullif(:speed_fraction, ''), 0.6) AS REAL) AS speed_fraction,
           CAST(coalesce(nullif(:baseline_runs, ''), 5) AS INTEGER) AS baseline_runs
),
point AS (
    SELECT runs.started_at, friction_points.run_id, friction_points.joint, friction_points.cycle,
           friction_points.direction, friction_points.minute, friction_points.torque_nm,
           friction_points.speed_fraction,
           max(friction_points.cycle) OVER of_joint AS last_cycle,
           rank() OVER (of_joint ORDER BY abs(friction_points.speed_fraction - chosen.speed_fraction),
                                          friction_points.speed_fraction) AS nearness
    FROM chosen
    JOIN runs ON runs.robot = chosen.robot AND runs.status = 'complete'
    JOIN friction_points ON friction_points.run_id = runs.run_id
    WHERE chosen.joint IS NULL OR friction_points.joint = chosen.joint
    WINDOW of_joint AS (PARTITION BY friction_points.run_id, friction_points.joint)
),
by_direction AS (
    SELECT started_at, run_id, joint, speed_fraction, avg(abs(torque_nm)) AS torque_nm,
           sum(minute) AS minutes, count(*) AS points
    FROM point
    WHERE nearness = 1 AND cycle >= max(1, last_cycle - last_cycle / 3)
    GROUP BY started_at, run_id, joint, speed_fraction, direction
),
run AS (
    SELECT started_at, run_id, joint, speed_fraction, avg(torque_nm) AS torque_nm,
           sum(minutes) / sum(points) AS minute,
           first_value(speed_fraction) OVER (PARTITION BY joint ORDER BY started_at, run_id) AS first_fraction
    FROM by_direction
    GROUP BY started_at, run_id, joint, speed_fraction
),
-- runs are compared at one speed, that of the joint's first run
warm AS (
    SELECT *, row_number() OVER (PARTITION BY joint ORDER BY started_at, run_id) AS place
    FROM run
    WHERE abs(speed_fraction - first_fraction) < 1e-6
),
-- SQLite has no median: the middle one of the sorted values, or the mean of the middle two
first_run AS (
    SELECT warm.joint, warm.torque_nm, warm.minute,
           row_number() OVER (PARTITION BY warm.joint ORDER BY warm.torque_nm) AS torque_place,
           row_number() OVER (PARTITION BY warm.joint ORDER BY warm.minute) AS minute_place,
           count(*) OVER (PARTITION BY warm.joint) AS runs
    FROM warm, chosen
    WHERE warm.place <= chosen.baseline_runs
),
baseline AS (
    SELECT joint,
           avg(CASE WHEN torque_place IN ((runs + 1) / 2, runs / 2 + 1) THEN torque_nm END) AS torque_nm,
           avg(CASE WHEN minute_place IN ((runs + 1) / 2, runs / 2 + 1) THEN minute END) AS minute,
           max(runs) AS runs
    FROM first_run
    GROUP BY joint
)
SELECT chosen.robot,
       warm.started_at,
       warm.run_id,
       warm.joint,
       CASE WHEN baseline.runs >= chosen.baseline_runs AND abs(warm.minute - baseline.minute) <= 0.25 * baseline.minute
            THEN warm.torque_nm / baseline.torque_nm
       END AS warm_friction_ratio,
       warm.torque_nm AS warm_friction_nm,
       CASE WHEN baseline.runs >= chosen.baseline_runs THEN baseline.torque_nm END AS baseline_nm,
       warm.minute,
       warm.speed_fraction
FROM chosen, warm
JOIN baseline ON baseline.joint = warm.joint
ORDER BY warm.joint, warm.started_at, warm.run_id;
