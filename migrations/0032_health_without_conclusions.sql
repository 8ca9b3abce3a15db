-- A robot of which nothing new is concluded is not healthy by what was concluded before.

DROP VIEW fleet_health;

CREATE VIEW fleet_health AS
WITH latest AS (
    SELECT robot.robot_id, robot.name AS robot, robot.expected_by, robot.overdue, run.run_id, run.started_at
    FROM robot
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = robot.robot_id AND newest.status = 'complete' AND newest.kind = 'test'
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
-- the newest export that was not understood, where no test is as new
faulty AS (
    SELECT latest.robot_id, run.source_name, run.reason
    FROM latest
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = latest.robot_id AND newest.status = 'quarantined' AND newest.kind = 'test'
              AND newest.superseded_by_run_id IS NULL AND newest.started_at > latest.started_at
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
member AS (
    SELECT latest.robot_id, run_joint_summary.joint FROM latest JOIN run_joint_summary USING (run_id)
    UNION
    SELECT latest.robot_id, joint_health.joint FROM latest JOIN joint_health USING (robot_id)
),
-- anomalies of the whole arm are every joint's
trouble AS (
    SELECT member.robot_id, member.joint,
           sum(anomaly.state = 'open') AS open_anomalies,
           max(anomaly.severity = 'critical') AS critical,
           max(anomaly.severity = 'warning') AS warning
    FROM member
    JOIN anomaly ON anomaly.robot_id = member.robot_id AND ifnull(anomaly.joint, member.joint) = member.joint
    WHERE anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
    GROUP BY member.robot_id, member.joint
),
judged AS (
    SELECT latest.robot_id,
           latest.robot,
           latest.run_id,
           latest.started_at,
           latest.expected_by,
           member.joint,
           joint_health.friction_index,
           joint_health.friction_quantity,
           joint_health.reason,
           joint_health.last_result_run_id,
           joint_health.trend,
           joint_health.warning_by,
           joint_health.warning_by_lower,
           joint_health.warning_by_upper,
           joint_health.critical_by,
           joint_health.critical_by_lower,
           joint_health.critical_by_upper,
           ifnull(trouble.open_anomalies, 0) AS open_anomalies,
           faulty.source_name AS faulty_name,
           faulty.reason AS faulty_reason,
           conclusion_fault.reason AS not_concluded,
           CASE
               WHEN faulty.robot_id IS NOT NULL OR conclusion_fault.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'no_result' THEN 'unknown'
               WHEN trouble.critical THEN 'critical'
               WHEN trouble.warning THEN 'warning'
               WHEN joint_health.knowledge = 'unsettled' THEN 'unknown'
               WHEN latest.overdue THEN 'overdue'
               WHEN ifnull(joint_health.knowledge, 'learning') = 'learning' THEN 'learning'
               ELSE 'ok'
           END AS status
    FROM member
    JOIN latest ON latest.robot_id = member.robot_id
    LEFT JOIN faulty ON faulty.robot_id = member.robot_id
    LEFT JOIN conclusion_fault ON conclusion_fault.robot_id = member.robot_id
    LEFT JOIN joint_health ON joint_health.robot_id = member.robot_id AND joint_health.joint = member.joint
    LEFT JOIN trouble ON trouble.robot_id = member.robot_id AND trouble.joint = member.joint
)
SELECT judged.robot,
       judged.joint,
       strftime('%Y-%m-%dT%H:%M:%fZ', judged.started_at / 1000000.0, 'unixepoch') AS last_run_at,
       run_joint_summary.relative_rmsd AS moving_relative_rmsd,
       judged.friction_index,
       judged.open_anomalies,
       judged.status,
       strftime('%Y-%m-%dT%H:%M:%fZ', result.started_at / 1000000.0, 'unixepoch') AS last_result_at,
       CASE
           WHEN judged.faulty_name IS NOT NULL
               THEN 'the latest export, ' || judged.faulty_name || ', is in quarantine: ' || judged.faulty_reason
           WHEN judged.not_concluded IS NOT NULL
               THEN 'nothing is concluded of the latest tests: ' || judged.not_concluded
           WHEN judged.status IN ('critical', 'warning') OR judged.status = 'ok' AND judged.reason IS NULL THEN (
               SELECT anomaly.message FROM anomaly
               WHERE anomaly.robot_id = judged.robot_id AND ifnull(anomaly.joint, judged.joint) = judged.joint
                     AND anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
               ORDER BY anomaly.severity = 'critical' DESC, anomaly.severity = 'warning' DESC,
                        anomaly.last_seen_at DESC, anomaly.anomaly_id DESC
               LIMIT 1
           )
           WHEN judged.status = 'overdue'
               THEN 'no test since that of ' || strftime('%Y-%m-%dT%H:%M:%fZ', judged.started_at / 1000000.0, 'unixepoch')
                    || '; the next was expected by ' || judged.expected_by
           ELSE judged.reason
       END AS reason,
       judged.expected_by,
       judged.friction_quantity,
       judged.trend,
       judged.warning_by,
       judged.warning_by_lower,
       judged.warning_by_upper,
       judged.critical_by,
       judged.critical_by_lower,
       judged.critical_by_upper
FROM judged
LEFT JOIN run_joint_summary
       ON run_joint_summary.run_id = judged.run_id AND run_joint_summary.joint = judged.joint
LEFT JOIN run AS result ON result.run_id = judged.last_result_run_id;
