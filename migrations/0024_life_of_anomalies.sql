-- The life of an anomaly: states, when it began as far as can be said, how sure its cause is, and what happened to it;
-- work on a robot, which begins a new baseline.

DROP VIEW fleet_health;
DROP VIEW anomalies;

-- As before, with more states, the onset, the peak's score, and the odds of the cause.
CREATE TABLE anomaly_with_life (
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
    peak_score    REAL,
    -- An episode outlives its runs: what people said of it is kept until the history is judged again.
    first_run_id  INTEGER REFERENCES run ON DELETE SET NULL,
    first_cycle   INTEGER CHECK (first_cycle >= 1),
    last_run_id   INTEGER REFERENCES run ON DELETE SET NULL,
    first_seen_at INTEGER NOT NULL,
    last_seen_at  INTEGER NOT NULL,
    -- Where the change most likely began; as first_* where nothing better is known.
    onset_run_id  INTEGER REFERENCES run ON DELETE SET NULL,
    onset_cycle   INTEGER CHECK (onset_cycle >= 1),
    onset_at      INTEGER,
    -- Odds of the named cause against all others together; NULL where causes were not compared.
    odds          REAL CHECK (odds >= 0),
    -- Rejected causes as a JSON array of {"cause", "odds"}, the likeliest first.
    alternatives  TEXT NOT NULL DEFAULT '[]',
    state         TEXT NOT NULL CHECK (state IN (
                      'open', 'acknowledged', 'shelved', 'maintenance', 'resolved', 'false_alarm')),
    -- Until when it is shelved.
    shelved_until INTEGER CHECK (state <> 'shelved' OR shelved_until IS NOT NULL),
    message       TEXT NOT NULL,
    -- Whether later runs no longer show it, whatever people said of it.
    ended         INTEGER NOT NULL DEFAULT 0 CHECK (ended IN (0, 1)),
    -- Start of the latest run that showed it when a person resolved it: a later one opens it again.
    resolved_seen_at INTEGER CHECK (resolved_seen_at IS NULL OR state = 'resolved'),
    -- Whether the history has it no longer; `state` then is what people had said, in case it comes back.
    withdrawn     INTEGER NOT NULL DEFAULT 0 CHECK (withdrawn IN (0, 1))
) STRICT;

INSERT INTO anomaly_with_life (anomaly_id, robot_id, joint, kind, quantity, severity, score, threshold, value, baseline,
                               peak_value, first_run_id, first_cycle, last_run_id, first_seen_at, last_seen_at,
                               onset_run_id, onset_cycle, onset_at, state, message, ended, withdrawn)
SELECT anomaly_id, robot_id, joint, kind, quantity, severity, score, threshold, value, baseline,
       peak_value, first_run_id, first_cycle, last_run_id, first_seen_at, last_seen_at,
       first_run_id, first_cycle, first_seen_at, state, message, state = 'resolved', withdrawn
FROM anomaly;

-- Numbers of deleted rows are not given again.
UPDATE sqlite_sequence
SET seq = max(seq, (SELECT of.seq FROM sqlite_sequence AS of WHERE of.name = 'anomaly'))
WHERE name = 'anomaly_with_life' AND EXISTS (SELECT 1 FROM sqlite_sequence AS of WHERE of.name = 'anomaly');
INSERT INTO sqlite_sequence (name, seq)
SELECT 'anomaly_with_life', seq FROM sqlite_sequence
WHERE name = 'anomaly' AND NOT EXISTS (SELECT 1 FROM sqlite_sequence AS of WHERE of.name = 'anomaly_with_life');

DROP TABLE anomaly;
ALTER TABLE anomaly_with_life RENAME TO anomaly;

CREATE INDEX anomaly_by_robot ON anomaly (robot_id, kind, joint);
CREATE INDEX anomaly_by_first_run ON anomaly (first_run_id);
CREATE INDEX anomaly_by_last_run ON anomaly (last_run_id);
CREATE INDEX anomaly_by_onset_run ON anomaly (onset_run_id);

-- What happened to an anomaly, by the program or a person: what is to be delivered, and who did what when and why.
-- Written in the transaction that changes the anomaly; never changed.
CREATE TABLE anomaly_event (
    -- AUTOINCREMENT: delivery asks for "newer than this number".
    anomaly_event_id INTEGER PRIMARY KEY AUTOINCREMENT,
    anomaly_id       INTEGER NOT NULL REFERENCES anomaly ON DELETE CASCADE,
    -- Wall time, microseconds since 1970.
    at               INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    what             TEXT NOT NULL CHECK (what IN (
                         'opened', 'worse', 'corrected', 'ended', 'reopened', 'withdrawn', 'overdue',
                         'acknowledged', 'shelved', 'unshelved', 'maintenance', 'resolved', 'false_alarm')),
    -- The anomaly as it was then.
    severity         TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score            REAL,
    value            REAL,
    message          TEXT NOT NULL,
    -- The latest run that had shown it then.
    run_id           INTEGER REFERENCES run ON DELETE SET NULL,
    -- The person; NULL where the program did it.
    who              TEXT,
    why              TEXT
) STRICT;
CREATE INDEX anomaly_event_by_anomaly ON anomaly_event (anomaly_id);
CREATE INDEX anomaly_event_by_run ON anomaly_event (run_id);

-- Work on a robot or one of its joints. The joint's baseline begins anew with the first test after it.
CREATE TABLE maintenance (
    maintenance_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    -- NULL: the whole arm.
    joint          INTEGER CHECK (joint >= 1),
    at             INTEGER NOT NULL,
    what           TEXT NOT NULL,
    who            TEXT,
    recorded_at    INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;
CREATE INDEX maintenance_by_robot ON maintenance (robot_id, at);

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
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.first_seen_at / 1000000.0, 'unixepoch') AS first_seen_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.last_seen_at / 1000000.0, 'unixepoch') AS last_seen_at,
       anomaly.state,
       anomaly.message,
       anomaly.last_run_id,
       anomaly.peak_value,
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.onset_at / 1000000.0, 'unixepoch') AS onset_at,
       anomaly.onset_run_id,
       anomaly.onset_cycle,
       anomaly.odds,
       anomaly.alternatives,
       anomaly.peak_score,
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.shelved_until / 1000000.0, 'unixepoch') AS shelved_until,
       anomaly.ended
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;

-- What happened to each anomaly, and who did what when and why.
CREATE VIEW anomaly_history AS
SELECT anomaly_event.anomaly_event_id,
       anomaly_event.anomaly_id,
       robot.name AS robot,
       anomaly.joint,
       anomaly.kind,
       strftime('%Y-%m-%dT%H:%M:%fZ', anomaly_event.at / 1000000.0, 'unixepoch') AS at,
       anomaly_event.what,
       anomaly_event.severity,
       anomaly_event.score,
       anomaly_event.value,
       anomaly_event.message,
       anomaly_event.who,
       anomaly_event.why,
       anomaly_event.run_id
FROM anomaly_event
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id);

-- Work on robots; `joint` is NULL for the whole arm.
CREATE VIEW maintenance_log AS
SELECT maintenance.maintenance_id,
       robot.name AS robot,
       maintenance.joint,
       strftime('%Y-%m-%dT%H:%M:%fZ', maintenance.at / 1000000.0, 'unixepoch') AS at,
       maintenance.what,
       maintenance.who,
       strftime('%Y-%m-%dT%H:%M:%fZ', maintenance.recorded_at / 1000000.0, 'unixepoch') AS recorded_at
FROM maintenance
JOIN robot USING (robot_id);

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
       judged.friction_quantity
FROM judged
LEFT JOIN run_joint_summary
       ON run_joint_summary.run_id = judged.run_id AND run_joint_summary.joint = judged.joint
LEFT JOIN run AS result ON result.run_id = judged.last_result_run_id;
