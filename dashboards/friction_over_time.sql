-- How does friction fall while the arm warms up, and does the fitted curve follow it? One row per friction point, with the
-- run's fit a + b exp(-t/t1) + c exp(-t/t2) at the same minute.
--
-- Many builds of SQLite lack exp(). The sixteenth power of a rational approximation to exp(-t/16) replaces it, accurate to
-- 1e-11 of b and c.
--
--   :robot            a robot; default: the one tested last
--   :run_id           one of its runs; default: the last complete one with such rows
--   :joint            only this joint; default: all
--   :speed_fraction   speed level; default: 0.6
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
                     ORDER BY started_at DESC, run_id DESC LIMIT 1)) AS run_id,
           CAST(coalesce(nullif(:speed_fraction, ''), 0.6) AS REAL) AS speed_fraction
    FROM robot
),
point AS (
    SELECT friction_points.robot, friction_points.run_id, friction_points.cycle, friction_points.minute,
           friction_points.joint, friction_points.speed_fraction, friction_points.direction,
           abs(friction_points.torque_nm) AS friction_nm,
           fit.model, fit.a_nm, fit.b_nm, fit.c_nm, fit.t1_min, fit.t2_min, fit.rmsd_nm,
           friction_points.minute / fit.t1_min / 16 AS x1,
           friction_points.minute / fit.t2_min / 16 AS x2
    FROM chosen
    JOIN friction_points ON friction_points.robot = chosen.robot AND friction_points.run_id = chosen.run_id
                        AND abs(friction_points.speed_fraction - chosen.speed_fraction) < 1e-6
    LEFT JOIN warmup_fits AS fit ON fit.run_id = friction_points.run_id AND fit.joint = friction_points.joint
                                AND abs(fit.speed_fraction - friction_points.speed_fraction) < 1e-6
    WHERE nullif(:joint, '') IS NULL OR friction_points.joint = CAST(:joint AS INTEGER)
),
sixteenth AS (
    SELECT *,
           (1680 - 840 * x1 + 180 * x1 * x1 - 20 * x1 * x1 * x1 + x1 * x1 * x1 * x1)
               / (1680 + 840 * x1 + 180 * x1 * x1 + 20 * x1 * x1 * x1 + x1 * x1 * x1 * x1) AS e1,
           (1680 - 840 * x2 + 180 * x2 * x2 - 20 * x2 * x2 * x2 + x2 * x2 * x2 * x2)
               / (1680 + 840 * x2 + 180 * x2 * x2 + 20 * x2 * x2 * x2 + x2 * x2 * x2 * x2) AS e2
    FROM point
),
quarter AS (
    SELECT *, e1 * e1 * e1 * e1 AS q1, e2 * e2 * e2 * e2 AS q2
    FROM sixteenth
)
SELECT robot,
       run_id,
       joint,
       cycle,
       minute,
       direction,
       friction_nm,
       a_nm + coalesce(b_nm * q1 * q1 * q1 * q1, 0) + coalesce(c_nm * q2 * q2 * q2 * q2, 0) AS fit_nm,
       model,
       rmsd_nm AS fit_rmsd_nm
FROM quarter
ORDER BY joint, minute;
