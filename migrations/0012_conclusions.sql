-- Conclusions that follow a robot's history, drawn apart from the ends of its runs.

-- How often the set of the robot's complete runs has changed, and at which count its conclusions (fits over
-- all runs, friction maps, anomalies, health) were drawn last. Different: they are to be drawn again.
ALTER TABLE robot ADD COLUMN history INTEGER NOT NULL DEFAULT 0;
ALTER TABLE robot ADD COLUMN concluded INTEGER NOT NULL DEFAULT 0;

-- Whatever completes, supersedes, reopens or takes away a run makes conclusions stale; no statement has to
-- remember it.
CREATE TRIGGER run_changes_history AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' OR NEW.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id IN (OLD.robot_id, NEW.robot_id);
END;

CREATE TRIGGER run_leaves_history AFTER DELETE ON run
WHEN OLD.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

-- 1: more of the history has shown that there was nothing. Such a finding depends on how much was known
-- when, so it is no conclusion any more and the view `anomalies` leaves it out; it is kept to explain a
-- message that somebody got.
ALTER TABLE anomaly ADD COLUMN withdrawn INTEGER NOT NULL DEFAULT 0 CHECK (withdrawn IN (0, 1));

-- The contract -------------------------------------------------------------------------------------

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
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.first_seen_at / 1000000.0, 'unixepoch'), '.000Z', 'Z')
           AS first_seen_at,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.last_seen_at / 1000000.0, 'unixepoch'), '.000Z', 'Z')
           AS last_seen_at,
       anomaly.state,
       anomaly.message,
       anomaly.last_run_id
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;
