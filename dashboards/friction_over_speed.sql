-- How does friction depend on speed, and how does the curve fall from the cold to the warm arm? One row per joint, cycle and
-- speed level. A curve is the rows of one joint and cycle, by speed; curves are ordered from cold to hot.
--
-- friction_nm is the mean magnitude of both directions, so that a torque offset cancels. It is NULL if one direction has no
-- plateau.
--
--   :robot    a robot; default: the one tested last
--   :run_id   one of its runs; default: the last complete one with such rows
--   :joint    only this joint; default: all
--   :cycle    only this cycle; default: all
WITH robot AS (
    SELECT coalesce(nullif(:robot, ''),
                    (SELECT robot FROM runs WHERE status = 'complete' AND kind <> 'production' ORDER BY started_at DESC LIMIT 1)) AS robot
),
chosen AS (
    SELECT robot.robot,
           coalesce(CAST(nullif(:run_id, '') AS INTEGER),
                    (SELECT run_id FROM runs
                     WHERE runs.robot = robot.robot AND status = 'complete'
                           AND EXISTS (SELECT 1 FROM friction_points AS own WHERE own.run_id = runs.run_id)
                     ORDER BY started_at DESC, run_id DESC LIMIT 1)) AS run_id
    FROM robot
),
level AS (
    SELECT friction_points.robot, friction_points.run_id, joint, cycle, speed_fraction,
           avg(minute) AS minute,
           avg(speed_rad_s) AS speed_rad_s,
           avg(CASE WHEN direction = 1 THEN torque_nm END) AS torque_forwards_nm,
           avg(CASE WHEN direction = -1 THEN torque_nm END) AS torque_backwards_nm
    FROM chosen
    JOIN friction_points ON friction_points.robot = chosen.robot AND friction_points.run_id = chosen.run_id
    WHERE (nullif(:joint, '') IS NULL OR joint = CAST(:joint AS INTEGER))
      AND (nullif(:cycle, '') IS NULL OR cycle = CAST(:cycle AS INTEGER))
    GROUP BY friction_points.robot, friction_points.run_id, joint, cycle, speed_fraction
)
SELECT robot,
       run_id,
       joint,
       cycle,
       minute,
       speed_fraction,
       speed_rad_s,
       (abs(torque_forwards_nm) + abs(torque_backwards_nm)) / 2 AS friction_nm,
       torque_forwards_nm,
       torque_backwards_nm
FROM level
ORDER BY joint, cycle, speed_fraction;
