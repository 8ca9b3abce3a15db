-- Which robots need attention, and when was the latest test of each? One row per robot, worst first. Production logs are no
-- tests. Dismissed exports do not count.
--
-- worst_joint is the joint whose status decides the robot's, with its reason; friction_index and moving_relative_rmsd are
-- the largest values over the joints, possibly of another joint.
--
--   :robot   only this robot; default: all
WITH joint AS (
    SELECT *,
           CASE status
               WHEN 'critical' THEN 5 WHEN 'warning' THEN 4 WHEN 'unknown' THEN 3 WHEN 'overdue' THEN 2
               WHEN 'learning' THEN 1 ELSE 0
           END AS rank
    FROM fleet_health
),
worst AS (
    SELECT *, row_number() OVER (PARTITION BY robot ORDER BY rank DESC, open_anomalies DESC, joint) AS place
    FROM joint
),
health AS (
    SELECT robot,
           max(friction_index) AS friction_index,
           max(moving_relative_rmsd) AS moving_relative_rmsd,
           max(last_result_at) AS last_result_at,
           max(last_run_at) AS last_run_at
    FROM joint
    GROUP BY robot
),
trouble AS (
    SELECT robot, sum(state = 'open') AS open_anomalies FROM anomalies GROUP BY robot
),
refused AS (
    SELECT robot, sum(state = 'open') AS open_runs, sum(state = 'dismissed') AS dismissed_runs
    FROM quarantine
    WHERE state IN ('open', 'dismissed')
    GROUP BY robot
),
of_robot AS (
    SELECT robot, count(*) AS runs, sum(status = 'complete' AND kind = 'test') AS complete_runs
    FROM runs
    GROUP BY robot
),
tested AS (
    SELECT of_robot.robot, of_robot.complete_runs, coalesce(refused.open_runs, 0) AS quarantined_runs
    FROM of_robot
    LEFT JOIN refused ON refused.robot = of_robot.robot
    WHERE of_robot.runs > coalesce(refused.dismissed_runs, 0)
)
SELECT tested.robot,
       coalesce(worst.status, 'untested') AS status,
       CASE WHEN worst.rank >= 3 THEN worst.joint END AS worst_joint,
       coalesce(trouble.open_anomalies, 0) AS open_anomalies,
       round(health.friction_index, 3) AS friction_index,
       round(health.moving_relative_rmsd, 4) AS moving_relative_rmsd,
       health.last_run_at,
       tested.complete_runs,
       tested.quarantined_runs,
       health.last_result_at,
       worst.reason
FROM tested
LEFT JOIN health ON health.robot = tested.robot
LEFT JOIN trouble ON trouble.robot = tested.robot
LEFT JOIN worst ON worst.robot = tested.robot AND worst.place = 1
WHERE nullif(:robot, '') IS NULL OR tested.robot = :robot
ORDER BY coalesce(worst.rank, -1) DESC, open_anomalies DESC, tested.robot;
