-- Starts that cannot be right, starts that a person has corrected, and runs that a person has set aside.
ALTER TABLE run ADD COLUMN set_aside text COLLATE "C" CHECK (set_aside IN ('person', 'implausible_date'));
ALTER TABLE run ADD COLUMN date_problem text COLLATE "C";
ALTER TABLE run ADD COLUMN recorded_start bigint;
ALTER TABLE run ADD COLUMN recorded_start_text text COLLATE "C";
CREATE INDEX run_set_aside ON run (robot_id, run_id) WHERE set_aside IS NOT NULL;

UPDATE robot SET history = history + 1
WHERE robot_id IN (SELECT run.robot_id FROM run WHERE run.status = 'complete');

CREATE OR REPLACE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       run.started_at_text AS started_at,
       run.source_name,
       CASE WHEN NOT run.growing THEN encode(run.content_hash, 'hex') END AS content_hash,
       run.rows,
       run.sample_rate_hz,
       run.cycles_stored AS cycles,
       CASE WHEN run.superseded_by_run_id IS NULL THEN run.status
            WHEN run.superseded_by_run_id = run.run_id THEN 'set_aside' ELSE 'superseded' END AS status,
       coalesce(run.reason, (SELECT blocked_files.message FROM blocked_files
                             WHERE blocked_files.run_id = run.run_id AND run.status = 'streaming')) AS reason,
       coalesce(run.reason_line, (SELECT blocked_file.line FROM blocked_file
                                  WHERE blocked_file.run_id = run.run_id AND run.status = 'streaming')) AS reason_line,
       run.reason_column,
       run.model,
       nullif(run.superseded_by_run_id, run.run_id) AS superseded_by_run_id,
       run.kind,
       run.rows_skipped,
       (SELECT nullif(host_session.host, '') FROM host_session
        WHERE host_session.host_session_id = run.host_session_id) AS host,
       (SELECT blocked_file.blocked_at FROM blocked_file
        WHERE blocked_file.run_id = run.run_id AND run.status = 'streaming') AS blocked_at,
       run.date_problem,
       run.recorded_start_text AS recorded_start_at
FROM run
JOIN robot USING (robot_id);

CREATE OR REPLACE VIEW fleet_health AS
WITH latest AS (
    SELECT robot.robot_id, robot.name AS robot, robot.expected_by, robot.overdue, run.run_id, run.started_at,
           run.started_at_text
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
-- a growing export of which nothing can be read behind a line
blocked AS (
    SELECT latest.robot_id, blocked_files.source_name, blocked_files.message
    FROM latest
    JOIN blocked_files ON blocked_files.robot = latest.robot
    WHERE NOT EXISTS (SELECT 1 FROM blocked_file AS later
                      WHERE later.robot = latest.robot AND later.path > blocked_files.source_path)
),
-- the tests that arrived last, where their dates cannot be right
misdated AS (
    SELECT latest.robot_id, run.source_name, run.date_problem
    FROM latest
    JOIN run ON run.run_id = (
        SELECT max(own.run_id) FROM run AS own WHERE own.robot_id = latest.robot_id AND own.set_aside = 'implausible_date'
    )
    WHERE run.kind = 'test' AND NOT EXISTS (
        SELECT 1 FROM run AS later
        WHERE later.robot_id = latest.robot_id AND later.status = 'complete' AND later.kind = 'test'
              AND later.run_id > run.run_id
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
           count(CASE WHEN anomaly.state = 'open' THEN 1 END) AS open_anomalies,
           max(CASE WHEN anomaly.severity = 'critical' THEN 1 ELSE 0 END) AS critical,
           max(CASE WHEN anomaly.severity = 'warning' THEN 1 ELSE 0 END) AS warning
    FROM member
    JOIN anomaly ON anomaly.robot_id = member.robot_id AND coalesce(anomaly.joint, member.joint) = member.joint
    WHERE anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
    GROUP BY member.robot_id, member.joint
),
judged AS (
    SELECT latest.robot_id,
           latest.robot,
           latest.run_id,
           latest.started_at_text,
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
           coalesce(trouble.open_anomalies, 0) AS open_anomalies,
           faulty.source_name AS faulty_name,
           faulty.reason AS faulty_reason,
           conclusion_fault.reason AS not_concluded,
           blocked.source_name AS blocked_name,
           blocked.message AS blocked_message,
           misdated.source_name AS misdated_name,
           misdated.date_problem,
           CASE
               WHEN faulty.robot_id IS NOT NULL OR conclusion_fault.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'no_result' THEN 'unknown'
               WHEN trouble.critical = 1 THEN 'critical'
               WHEN trouble.warning = 1 THEN 'warning'
               WHEN blocked.robot_id IS NOT NULL OR misdated.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'unsettled' THEN 'unknown'
               WHEN latest.overdue THEN 'overdue'
               WHEN coalesce(joint_health.knowledge, 'learning') = 'learning' THEN 'learning'
               ELSE 'ok'
           END AS status
    FROM member
    JOIN latest ON latest.robot_id = member.robot_id
    LEFT JOIN faulty ON faulty.robot_id = member.robot_id
    LEFT JOIN conclusion_fault ON conclusion_fault.robot_id = member.robot_id
    LEFT JOIN blocked ON blocked.robot_id = member.robot_id
    LEFT JOIN misdated ON misdated.robot_id = member.robot_id
    LEFT JOIN joint_health ON joint_health.robot_id = member.robot_id AND joint_health.joint = member.joint
    LEFT JOIN trouble ON trouble.robot_id = member.robot_id AND trouble.joint = member.joint
)
SELECT judged.robot,
       judged.joint,
       judged.started_at_text AS last_run_at,
       run_joint_summary.relative_rmsd AS moving_relative_rmsd,
       judged.friction_index,
       judged.open_anomalies,
       judged.status,
       result.started_at_text AS last_result_at,
       CASE
           WHEN judged.faulty_name IS NOT NULL
               THEN 'the latest export, ' || judged.faulty_name || ', is in quarantine: ' || judged.faulty_reason
           WHEN judged.not_concluded IS NOT NULL
               THEN 'nothing is concluded of the latest tests: ' || judged.not_concluded
           WHEN judged.status = 'unknown' AND judged.blocked_name IS NOT NULL
               THEN judged.blocked_name || ' ' || judged.blocked_message
           WHEN judged.status = 'unknown' AND judged.misdated_name IS NOT NULL
               THEN 'the date of the latest test, ' || judged.misdated_name || ', cannot be right: it is '
                    || judged.date_problem || '; judged by the tests until ' || judged.started_at_text
           WHEN judged.status IN ('critical', 'warning') OR judged.status = 'ok' AND judged.reason IS NULL THEN (
               SELECT anomaly.message FROM anomaly
               WHERE anomaly.robot_id = judged.robot_id AND coalesce(anomaly.joint, judged.joint) = judged.joint
                     AND anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
               ORDER BY anomaly.severity = 'critical' DESC, anomaly.severity = 'warning' DESC,
                        anomaly.last_seen_at DESC, anomaly.anomaly_id DESC
               LIMIT 1
           )
           WHEN judged.status = 'overdue'
               THEN 'no test since that of ' || judged.started_at_text
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
