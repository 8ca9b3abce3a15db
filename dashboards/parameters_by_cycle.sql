-- How large are the dynamic parameters from cycle to cycle, and how certain are they? The band low..high is the 95 % interval.
--
-- A parameter is a base parameter; grouping is the sum of link parameters that it is.
--
--   :robot       a robot; default: the one tested last
--   :run_id      one of its runs; default: the last complete one with such rows
--   :joint       only this joint; default: all
--   :parameter   only this parameter, such as mPx, Izz, f1 or I_m; default: all
WITH robot AS (
    SELECT coalesce(nullif(:robot, ''),
                    (SELECT robot FROM runs WHERE status = 'complete' AND kind <> 'production' ORDER BY started_at DESC LIMIT 1)) AS robot
),
chosen AS (
    SELECT robot.robot,
           coalesce(CAST(nullif(:run_id, '') AS INTEGER),
                    (SELECT run_id FROM runs
                     WHERE runs.robot = robot.robot AND status = 'complete'
                           AND EXISTS (SELECT 1 FROM cycle_parameters AS own WHERE own.run_id = runs.run_id)
                     ORDER BY started_at DESC, run_id DESC LIMIT 1)) AS run_id
    FROM robot
)
SELECT cycle_parameters.robot,
       cycle_parameters.run_id,
       cycle_parameters.cycle,
       cycles.started_at,
       cycle_parameters.joint,
       cycle_parameters.parameter,
       cycle_parameters.value,
       cycle_parameters.interval_low AS low,
       cycle_parameters.interval_high AS high,
       cycle_parameters.unit,
       cycle_parameters.grouping
FROM chosen
JOIN cycle_parameters ON cycle_parameters.robot = chosen.robot AND cycle_parameters.run_id = chosen.run_id
JOIN cycles ON cycles.run_id = cycle_parameters.run_id AND cycles.cycle = cycle_parameters.cycle
WHERE (nullif(:joint, '') IS NULL OR cycle_parameters.joint = CAST(:joint AS INTEGER))
  AND (nullif(:parameter, '') IS NULL OR cycle_parameters.parameter = :parameter)
ORDER BY cycle_parameters.joint, cycle_parameters.parameter, cycle_parameters.cycle;
