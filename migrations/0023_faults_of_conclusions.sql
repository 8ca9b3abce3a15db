-- Robots whose conclusions cannot be drawn, and faults of exports that a person has put aside.

-- One row a robot, from the attempt that failed until one succeeds. Other robots and the program go on.
CREATE TABLE conclusion_fault (
    robot_id INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    reason   TEXT NOT NULL,
    -- Attempts that failed, one after the other, and when the first and the last did.
    tries    INTEGER NOT NULL DEFAULT 1 CHECK (tries >= 1),
    first_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    last_at  INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;

-- A person has said that nothing is to be done about a fault. Asking for another try withdraws that; what was said
-- stays here.
CREATE TABLE dismissal (
    dismissal_id INTEGER PRIMARY KEY,
    fault_id     INTEGER NOT NULL REFERENCES fault ON DELETE CASCADE,
    dismissed_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    dismissed_by TEXT NOT NULL,
    reason       TEXT NOT NULL,
    withdrawn_at INTEGER
) STRICT;
CREATE INDEX dismissal_by_fault ON dismissal (fault_id);
CREATE UNIQUE INDEX dismissal_in_force ON dismissal (fault_id) WHERE withdrawn_at IS NULL;

-- The contract -------------------------------------------------------------------------------------

-- Robots of which nothing new is concluded, and why. Its times are wall time.
CREATE VIEW conclusion_faults AS
SELECT robot.name AS robot,
       conclusion_fault.reason,
       conclusion_fault.tries,
       strftime('%Y-%m-%dT%H:%M:%fZ', conclusion_fault.first_at / 1000000.0, 'unixepoch') AS first_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', conclusion_fault.last_at / 1000000.0, 'unixepoch') AS last_at
FROM conclusion_fault
JOIN robot USING (robot_id);

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
           WHEN dismissal.dismissal_id IS NOT NULL THEN 'dismissed'
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
       fault.fault_id,
       strftime('%Y-%m-%dT%H:%M:%fZ', dismissal.dismissed_at / 1000000.0, 'unixepoch') AS dismissed_at,
       dismissal.dismissed_by,
       dismissal.reason AS dismissal_reason
FROM fault
JOIN run USING (run_id)
JOIN robot USING (robot_id)
LEFT JOIN dismissal ON dismissal.fault_id = fault.fault_id AND dismissal.withdrawn_at IS NULL;
