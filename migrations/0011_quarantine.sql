-- What was found wrong in exports, with its history: a quarantined run keeps its number when it is read
-- again, and what each attempt found stays here.

CREATE TABLE fault (
    fault_id      INTEGER PRIMARY KEY,
    run_id        INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    -- Without place and remedy; where there is a value, it goes on after "value is ".
    problem       TEXT NOT NULL,
    -- In the decompressed file: lines from 1, bytes from 0, of the cell or else of the line.
    line          INTEGER CHECK (line >= 1),
    column_name   TEXT,
    byte          INTEGER CHECK (byte >= 0),
    value         TEXT,
    remedy        TEXT NOT NULL,
    -- Whole cycles before the fault, which were stored.
    cycles_stored INTEGER NOT NULL CHECK (cycles_stored >= 0),
    -- Attempts that found just this, one after the other, and when the first and the last did.
    tries         INTEGER NOT NULL DEFAULT 1 CHECK (tries >= 1),
    first_at      INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    last_at       INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;
CREATE INDEX fault_by_run ON fault (run_id, fault_id);

-- What older programs have written down: the sentence as a whole.
INSERT INTO fault (run_id, problem, line, column_name, remedy, cycles_stored, first_at, last_at)
SELECT run_id, reason, iif(reason_line >= 1, reason_line, NULL), reason_column, '', cycles_stored, ingested_at, ingested_at
FROM run
WHERE status = 'quarantined' AND superseded_by_run_id IS NULL;

-- A person has asked for the export to be read again; the daemon does, and takes the mark away.
ALTER TABLE run ADD COLUMN retry_asked_at INTEGER;
CREATE INDEX run_by_retry ON run (retry_asked_at) WHERE retry_asked_at IS NOT NULL;

-- Runs of one file name: a corrected export finds the faulty one, and an upload the name that is taken.
CREATE INDEX run_by_name ON run (source_name);

-- The contract -------------------------------------------------------------------------------------

-- One row a fault. Its times are wall time, so that this view alone differs between two databases fed alike.
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
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', fault.first_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS first_at,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', fault.last_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS last_at,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', run.retry_asked_at / 1000000.0, 'unixepoch'), '.000Z', 'Z')
           AS retry_asked_at,
       run.superseded_by_run_id,
       fault.fault_id
FROM fault
JOIN run USING (run_id)
JOIN robot USING (robot_id);
