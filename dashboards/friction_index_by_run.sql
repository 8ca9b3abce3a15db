-- How does the friction index of each joint develop over the runs of a robot? It is friction divided by the joint's own
-- baseline at equal speed and thermal state, 1 = unchanged, with its 95 % interval. Detectors, fleet_health and
-- `armwatch friction --index` use the same index.
--
-- A run without a row has no index: a single cycle, too few runs for a friction map, or points that do not show wear. For
-- such runs, use warm_friction_by_run.sql.
--
--   :robot   a robot; default: the one tested last
--   :joint   only this joint; default: all
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
