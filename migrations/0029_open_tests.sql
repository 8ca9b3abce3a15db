-- Alarms of a test that is still being written.

-- The test that alone shows the anomaly and is not complete; NULL for what complete runs say. Until it is complete,
-- conclusions from the complete runs leave the anomaly alone.
ALTER TABLE anomaly ADD COLUMN open_run_id INTEGER REFERENCES run ON DELETE SET NULL;
CREATE INDEX anomaly_by_open_run ON anomaly (open_run_id) WHERE open_run_id IS NOT NULL;

-- A test that ends otherwise than complete leaves its anomalies to be judged without it. One that completes changes the
-- history anyway.
CREATE TRIGGER open_run_changes_history AFTER UPDATE OF status ON run
WHEN OLD.status = 'streaming' AND NEW.status NOT IN ('streaming', 'complete')
     AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id)
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

CREATE TRIGGER open_run_leaves_history BEFORE DELETE ON run
WHEN OLD.status <> 'complete' AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id)
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

-- The contract -------------------------------------------------------------------------------------

DROP VIEW anomalies;

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
       anomaly.ended,
       anomaly.open_run_id IS NOT NULL AS provisional
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;
