-- How well does the identified model explain the torque of each joint in each cycle? relative_rmsd is the deviation as a
-- fraction of the RMS of the measured torque, over the rows in which the joint moves. mark shows values above 10 % and 15 %,
-- the shipped limits of the accuracy detector.
--
--   :robot    a robot; default: the one tested last
--   :run_id   one of its runs; default: the last complete one with such rows
--   :joint    only this joint; default: all
--   :stage    excitation, friction, warming or all; default: excitation
WITH robot AS (
    SELECT coalesce(nullif(:robot, ''),
                    (SELECT robot FROM runs WHERE status = 'complete' AND kind <> 'production' ORDER BY started_at DESC LIMIT 1)) AS robot
),
chosen AS (
    SELECT robot.robot,
           coalesce(CAST(nullif(:run_id, '') AS INTEGER),
                    (SELECT run_id FROM runs
                     WHERE runs.robot = robot.robot AND status = 'complete'
                           AND EXISTS (SELECT 1 FROM cycle_rmsd AS own WHERE own.run_id = runs.run_id)
                     ORDER BY started_at DESC, run_id DESC LIMIT 1)) AS run_id
    FROM robot
)
SELECT cycle_rmsd.robot,
       cycle_rmsd.run_id,
       cycle_rmsd.cycle,
       cycles.started_at,
       cycle_rmsd.joint,
       cycle_rmsd.moving_relative_rmsd AS relative_rmsd,
       cycle_rmsd.moving_rmsd_nm AS rmsd_nm,
       0.10 AS limit_10_percent,
       0.15 AS limit_15_percent,
       CASE
           WHEN cycle_rmsd.moving_relative_rmsd > 0.15 THEN 'over 15 %'
           WHEN cycle_rmsd.moving_relative_rmsd > 0.10 THEN 'over 10 %'
           WHEN cycle_rmsd.moving_relative_rmsd IS NOT NULL THEN 'within 10 %'
       END AS mark,
       cycle_rmsd.moving_samples AS samples
FROM chosen
JOIN cycle_rmsd ON cycle_rmsd.robot = chosen.robot AND cycle_rmsd.run_id = chosen.run_id
JOIN cycles ON cycles.run_id = cycle_rmsd.run_id AND cycles.cycle = cycle_rmsd.cycle
WHERE cycle_rmsd.verification = 'self'
  AND cycle_rmsd.stage = coalesce(nullif(:stage, ''), 'excitation')
  AND (nullif(:joint, '') IS NULL OR cycle_rmsd.joint = CAST(:joint AS INTEGER))
ORDER BY cycle_rmsd.joint, cycle_rmsd.cycle;
