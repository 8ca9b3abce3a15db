-- How does the friction index of each joint develop over the runs of a robot? It is friction against the
-- joint's own baseline at equal speed and equal thermal state, 1 = unchanged, with its 95 % interval: the
-- index of the view friction_index, of `armwatch friction --index`, of detectors and of fleet_health.
--
-- A run without a row has no index: a single cycle, too few runs for a friction map, or points that
-- tell nothing of wear. warm_friction_by_run.sql has what stands for it there.
--
--   :robot   a robot; the one tested last if left out
--   :joint   only this joint; all if left out
WITH chosen AS (
    SELECT coalesce(nullif(:robot, ''),
                    (SELECT robot FROM runs WHERE status = 'complete' AND kind <> 'production' ORDER BY started_at DESC LIMIT 1)) AS robot,
           CAST(nullif(:joint, '') AS INTEGER) AS joint
)
SELECT friction_index.robot,
       friction_index.started_at,
       friction_index.run_id,
       friction_index.joint,
       friction_index.friction_index,
       friction_index.friction_index - 1.959964 * friction_index.friction_index_std_error AS interval_low,
       friction_index.friction_index + 1.959964 * friction_index.friction_index_std_error AS interval_high,
       friction_index.raw_index,
       friction_index.short_run
FROM chosen
JOIN friction_index ON friction_index.robot = chosen.robot
WHERE chosen.joint IS NULL OR friction_index.joint = chosen.joint
ORDER BY friction_index.joint, friction_index.started_at, friction_index.run_id;
