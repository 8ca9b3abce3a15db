-- Whether a test gave a result, why it did not, and what is known of each joint since when.

-- Why a cycle was refused, as data: the findings, the likeliest first. A refused cycle without rows had nothing to
-- identify parameters on; what else was measured in it counts.
CREATE TABLE cycle_refusal (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    number   INTEGER NOT NULL CHECK (number >= 1),
    -- Name of the check, such as stuck_channel; earlier for cycles stored before this table was.
    finding  TEXT NOT NULL,
    channel  TEXT NOT NULL CHECK (channel IN (
                 'position', 'velocity', 'torque', 'time', 'rows', 'motion', 'model')),
    -- NULL: the whole arm's.
    joint    INTEGER CHECK (joint >= 1),
    sentence TEXT NOT NULL,
    PRIMARY KEY (cycle_id, number)
) STRICT, WITHOUT ROWID;

-- Cycles of earlier versions have a sentence only. It names the joint first and a channel as "the torque signal".
INSERT INTO cycle_refusal (cycle_id, number, finding, channel, joint, sentence)
SELECT cycle.cycle_id, 1, 'earlier',
       CASE
           WHEN cycle.reason LIKE 'joint %: the torque signal %' THEN 'torque'
           WHEN cycle.reason LIKE 'joint %: the velocity signal %' THEN 'velocity'
           WHEN cycle.reason LIKE 'joint %: the position signal %' THEN 'position'
           WHEN cycle.reason LIKE '%position%' THEN 'position'
           ELSE 'model'
       END,
       CASE WHEN cycle.reason LIKE 'joint %' AND CAST(substr(cycle.reason, 7) AS INTEGER) >= 1
            THEN CAST(substr(cycle.reason, 7) AS INTEGER) END,
       cycle.reason
FROM cycle
JOIN run USING (run_id)
WHERE cycle.status = 'refused' AND run.kind = 'test'
      AND cycle.reason <> 'the cycle has no excitation stage to identify parameters on';

-- When the next test should have begun at the latest, by the robot's own usual interval; RFC 3339 as in views. It
-- follows from the history.
ALTER TABLE robot ADD COLUMN expected_by TEXT;
-- 1: the daemon saw a test of this robot arrive in time, so that one that fails to come is worth saying.
ALTER TABLE robot ADD COLUMN watched INTEGER NOT NULL DEFAULT 0 CHECK (watched IN (0, 1));
-- 1: the daemon saw expected_by pass.
ALTER TABLE robot ADD COLUMN overdue INTEGER NOT NULL DEFAULT 0 CHECK (overdue IN (0, 1));

DROP VIEW fleet_health;
DROP VIEW anomalies;

-- As before, but the joint may be NULL (the whole arm), and with the first cycle and the peak of an episode.
CREATE TABLE anomaly_of_arm (
    anomaly_id    INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id      INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint         INTEGER CHECK (joint >= 1),
    kind          TEXT NOT NULL CHECK (kind IN (
                      'drift', 'oscillation', 'step', 'thermal', 'payload', 'sensor', 'accuracy', 'fleet')),
    quantity      TEXT NOT NULL,
    severity      TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score         REAL,
    threshold     REAL,
    value         REAL,
    baseline      REAL,
    peak_value    REAL,
    first_run_id  INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    first_cycle   INTEGER CHECK (first_cycle >= 1),
    last_run_id   INTEGER REFERENCES run ON DELETE SET NULL,
    first_seen_at INTEGER NOT NULL,
    last_seen_at  INTEGER NOT NULL,
    state         TEXT NOT NULL CHECK (state IN ('open', 'acknowledged', 'resolved')),
    message       TEXT NOT NULL,
    withdrawn     INTEGER NOT NULL DEFAULT 0 CHECK (withdrawn IN (0, 1))
) STRICT;

INSERT INTO anomaly_of_arm (anomaly_id, robot_id, joint, kind, quantity, severity, score, threshold, value, baseline,
                            first_run_id, last_run_id, first_seen_at, last_seen_at, state, message, withdrawn)
SELECT anomaly_id, robot_id, joint, kind, quantity, severity, score, threshold, value, baseline,
       first_run_id, last_run_id, first_seen_at, last_seen_at, state, message, withdrawn
FROM anomaly;

-- Numbers of deleted rows are not given again.
UPDATE sqlite_sequence
SET seq = max(seq, (SELECT of.seq FROM sqlite_sequence AS of WHERE of.name = 'anomaly'))
WHERE name = 'anomaly_of_arm' AND EXISTS (SELECT 1 FROM sqlite_sequence AS of WHERE of.name = 'anomaly');
INSERT INTO sqlite_sequence (name, seq)
SELECT 'anomaly_of_arm', seq FROM sqlite_sequence
WHERE name = 'anomaly' AND NOT EXISTS (SELECT 1 FROM sqlite_sequence AS of WHERE of.name = 'anomaly_of_arm');

DROP TABLE anomaly;
ALTER TABLE anomaly_of_arm RENAME TO anomaly;

-- ifnull, because a unique index takes every NULL for another value.
CREATE UNIQUE INDEX anomaly_key ON anomaly (robot_id, ifnull(joint, 0), kind, quantity, first_run_id);
CREATE INDEX anomaly_by_first_run ON anomaly (first_run_id);
CREATE INDEX anomaly_by_last_run ON anomaly (last_run_id);

-- Where the joint stands after the robot's latest test.
CREATE TABLE joint_knowledge (
    robot_id           INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint              INTEGER NOT NULL CHECK (joint >= 1),
    friction_index     REAL,
    friction_quantity  TEXT,
    -- compared: the latest test compares with the baseline. learning: no baseline yet. unsettled: one test alone
    -- does not settle it. no_result: the latest test says nothing of the arm.
    knowledge          TEXT NOT NULL CHECK (knowledge IN ('compared', 'learning', 'unsettled', 'no_result')),
    reason             TEXT,
    last_result_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;

INSERT INTO joint_knowledge (robot_id, joint, friction_index, knowledge)
SELECT robot_id, joint, friction_index, CASE WHEN learning THEN 'learning' ELSE 'compared' END FROM joint_health;
DROP TABLE joint_health;
ALTER TABLE joint_knowledge RENAME TO joint_health;
CREATE INDEX joint_health_by_last_result ON joint_health (last_result_run_id);

-- What was concluded before does not know of tests without result.
UPDATE robot SET history = history + 1
WHERE EXISTS (SELECT 1 FROM run WHERE run.robot_id = robot.robot_id AND run.status = 'complete');

-- The contract -------------------------------------------------------------------------------------

CREATE VIEW anomalies AS
SELECT anomaly.anomaly_id,
       robot.name AS robot,
       anomaly.first_run_id AS run_id,
       anomaly.first_cycle AS cycle,
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
       anomaly.last_run_id,
       anomaly.peak_value
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;

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
    WHERE anomaly.state <> 'resolved'
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
           ifnull(trouble.open_anomalies, 0) AS open_anomalies,
           faulty.source_name AS faulty_name,
           faulty.reason AS faulty_reason,
           CASE
               WHEN faulty.robot_id IS NOT NULL OR joint_health.knowledge = 'no_result' THEN 'unknown'
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
           WHEN judged.status IN ('critical', 'warning') OR judged.status = 'ok' AND judged.reason IS NULL THEN (
               SELECT anomaly.message FROM anomaly
               WHERE anomaly.robot_id = judged.robot_id AND ifnull(anomaly.joint, judged.joint) = judged.joint
                     AND anomaly.state <> 'resolved'
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
       judged.friction_quantity
FROM judged
LEFT JOIN run_joint_summary
       ON run_joint_summary.run_id = judged.run_id AND run_joint_summary.joint = judged.joint
LEFT JOIN run AS result ON result.run_id = judged.last_result_run_id;
