-- Recordings of ordinary work, window by window, held against the parameters of tests.

-- Tests alone make parameters, friction, statistics, baselines and health; production is only held against
-- them, so that every statement on a robot's history asks for the kind.
ALTER TABLE run ADD COLUMN kind TEXT NOT NULL DEFAULT 'test' CHECK (kind IN ('test', 'production'));

-- Measured torque of a window (a cycle of a run of production) against what the parameters of a test give.
-- A window without rows here was recorded before there was a test.
CREATE TABLE production_check (
    cycle_id             INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                INTEGER NOT NULL CHECK (joint >= 1),
    reference_run_id     INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    rmsd_nm              REAL,
    relative_rmsd        REAL,
    samples              INTEGER NOT NULL CHECK (samples >= 0),
    moving_rmsd_nm       REAL,
    moving_relative_rmsd REAL,
    moving_samples       INTEGER NOT NULL CHECK (moving_samples >= 0),
    -- Mean and largest size of measured less estimated torque over the moving rows; NULL where the check was
    -- made later, from factors, which do not know them.
    bias_nm              REAL,
    max_nm               REAL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;
-- Deleting a run looks for what refers to it.
CREATE INDEX production_check_by_reference ON production_check (reference_run_id);

-- The contract -------------------------------------------------------------------------------------

DROP VIEW runs;

CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
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
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', latest.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS last_run_at,
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

CREATE VIEW production_checks AS
SELECT run.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
       cycle.duration_s,
       cycle.rows,
       production_check.joint,
       production_check.reference_run_id,
       production_check.moving_relative_rmsd,
       production_check.moving_rmsd_nm,
       production_check.relative_rmsd,
       production_check.rmsd_nm,
       production_check.bias_nm,
       production_check.max_nm,
       production_check.moving_samples,
       production_check.samples,
       CASE WHEN production_check.joint IS NULL THEN ifnull(cycle.reason, 'no model yet') END AS reason
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;
