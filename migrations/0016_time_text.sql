-- Times have milliseconds in every view and always, so that text order is time order and one format reads them.

DROP VIEW cycles;

CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch') AS started_at,
       cycle.duration_s,
       cycle.rows,
       cycle.status,
       cycle.reason,
       cycle.remarks,
       cycle.sample_rate_hz,
       cycle.cutoff_hz,
       cycle.samples,
       cycle.condition_number,
       cycle.scaled_condition_number,
       cycle.residual_std_nm,
       cycle.estimator
FROM cycle
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW friction_index;

CREATE VIEW friction_index AS
SELECT robot.name AS robot,
       found.run_id,
       strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch') AS started_at,
       found.joint,
       found.friction_index,
       found.friction_index_std_error,
       found.ambient_coldness,
       found.ambient_coldness_std_error,
       found.coldness_at_start,
       found.points,
       found.raw_index,
       found.short_run
FROM run_friction_index AS found
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW runs;

CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch') AS started_at,
       run.source_name,
       CASE WHEN NOT run.growing THEN lower(hex(run.content_hash)) END AS content_hash,
       run.rows,
       run.sample_rate_hz,
       run.cycles_stored AS cycles,
       CASE WHEN run.superseded_by_run_id IS NULL THEN run.status ELSE 'superseded' END AS status,
       run.reason,
       run.reason_line,
       run.reason_column,
       run.model,
       run.superseded_by_run_id,
       run.kind
FROM run
JOIN robot USING (robot_id);

DROP VIEW fleet_health;

CREATE VIEW fleet_health AS
WITH latest AS (
    SELECT robot.robot_id, robot.name AS robot, run.run_id, run.started_at
    FROM robot
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = robot.robot_id AND newest.status = 'complete' AND newest.kind = 'test'
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
member AS (
    SELECT latest.robot_id, run_joint_summary.joint FROM latest JOIN run_joint_summary USING (run_id)
    UNION
    SELECT latest.robot_id, joint_health.joint FROM latest JOIN joint_health USING (robot_id)
),
trouble AS (
    SELECT robot_id, joint,
           sum(state = 'open') AS open_anomalies,
           max(severity = 'critical') AS critical,
           max(severity = 'warning') AS warning
    FROM anomaly
    WHERE state <> 'resolved'
    GROUP BY robot_id, joint
)
SELECT latest.robot,
       member.joint,
       strftime('%Y-%m-%dT%H:%M:%fZ', latest.started_at / 1000000.0, 'unixepoch') AS last_run_at,
       run_joint_summary.relative_rmsd AS moving_relative_rmsd,
       joint_health.friction_index,
       ifnull(trouble.open_anomalies, 0) AS open_anomalies,
       CASE
           WHEN trouble.critical THEN 'critical'
           WHEN trouble.warning THEN 'warning'
           WHEN ifnull(joint_health.learning, 1) THEN 'learning'
           ELSE 'ok'
       END AS status
FROM member
JOIN latest ON latest.robot_id = member.robot_id
LEFT JOIN run_joint_summary ON run_joint_summary.run_id = latest.run_id AND run_joint_summary.joint = member.joint
LEFT JOIN joint_health ON joint_health.robot_id = member.robot_id AND joint_health.joint = member.joint
LEFT JOIN trouble ON trouble.robot_id = member.robot_id AND trouble.joint = member.joint;

DROP VIEW quarantine;

CREATE VIEW quarantine AS
SELECT run.run_id,
       robot.name AS robot,
       run.source_name,
       run.source_path,
       CASE
           WHEN run.superseded_by_run_id IS NOT NULL THEN 'superseded'
           WHEN run.status = 'complete' THEN 'stored'
           WHEN run.status = 'streaming' THEN 'reading'
           WHEN fault.fault_id < (SELECT max(later.fault_id) FROM fault AS later WHERE later.run_id = run.run_id)
               THEN 'earlier'
           ELSE 'open'
       END AS state,
       fault.problem,
       fault.line,
       fault.column_name,
       fault.byte,
       fault.value,
       fault.remedy,
       fault.cycles_stored,
       fault.tries,
       strftime('%Y-%m-%dT%H:%M:%fZ', fault.first_at / 1000000.0, 'unixepoch') AS first_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', fault.last_at / 1000000.0, 'unixepoch') AS last_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', run.retry_asked_at / 1000000.0, 'unixepoch')
           AS retry_asked_at,
       run.superseded_by_run_id,
       fault.fault_id
FROM fault
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW anomalies;

CREATE VIEW anomalies AS
SELECT anomaly.anomaly_id,
       robot.name AS robot,
       anomaly.first_run_id AS run_id,
       CAST(NULL AS INTEGER) AS cycle,
       anomaly.joint,
       anomaly.kind,
       anomaly.quantity,
       anomaly.severity,
       anomaly.score,
       anomaly.threshold,
       anomaly.value,
       anomaly.baseline,
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.first_seen_at / 1000000.0, 'unixepoch')
           AS first_seen_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.last_seen_at / 1000000.0, 'unixepoch')
           AS last_seen_at,
       anomaly.state,
       anomaly.message,
       anomaly.last_run_id
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;

DROP VIEW production_checks;

CREATE VIEW production_checks AS
SELECT run.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch') AS started_at,
       cycle.duration_s,
       cycle.rows,
       production_check.joint,
       production_check.reference_run_id,
       production_check.moving_relative_rmsd,
       production_check.moving_rmsd_nm,
       production_check.relative_rmsd,
       production_check.rmsd_nm,
       production_check.friction_excess,
       production_check.friction_share,
       production_check.moving_samples,
       production_check.samples,
       CASE WHEN production_check.joint IS NULL THEN ifnull(cycle.reason, 'no model yet') END AS reason
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;

DROP VIEW production_trend;

CREATE VIEW production_trend AS
SELECT robot.name AS robot,
       run.run_id,
       strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch') AS started_at,
       production_summary.joint,
       production_summary.reference_run_id,
       production_summary.windows,
       production_summary.relative_rmsd AS moving_relative_rmsd,
       production_summary.friction_excess,
       production_summary.friction_share
FROM production_summary
JOIN run USING (run_id)
JOIN robot USING (robot_id)
WHERE run.superseded_by_run_id IS NULL;
