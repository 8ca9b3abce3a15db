-- Exports that still grow, and contents that another one has replaced.

-- 1 while the export is read as it grows: content_hash is then a number without meaning that only
-- keeps the key unique, and becomes the hash of the content when the run is complete.
ALTER TABLE run ADD COLUMN growing INTEGER NOT NULL DEFAULT 0 CHECK (growing IN (0, 1));

-- What the stored cycles were read from: so many first bytes of the export with this hash. Moves in the
-- transaction that stores a cycle. A file that begins with the same bytes goes on with this run, another
-- one is another recording. NULL: no cycle was stored, or the whole content is meant.
ALTER TABLE run ADD COLUMN prefix_bytes INTEGER CHECK (prefix_bytes >= 0);
ALTER TABLE run ADD COLUMN prefix_hash BLOB CHECK (length(prefix_hash) = 32);

-- The run whose file this content was written over, to be superseded when this run is complete.
ALTER TABLE run ADD COLUMN replaces_run_id INTEGER REFERENCES run ON DELETE SET NULL;

-- The run that has taken this one's place. Such a run has the status 'quarantined' in this table, because
-- like a quarantined one it takes no part in conclusions; the view says 'superseded'.
ALTER TABLE run ADD COLUMN superseded_by_run_id INTEGER REFERENCES run ON DELETE SET NULL;

CREATE INDEX run_by_replaced ON run (replaces_run_id) WHERE replaces_run_id IS NOT NULL;
CREATE INDEX run_by_successor ON run (superseded_by_run_id) WHERE superseded_by_run_id IS NOT NULL;

-- The file's number in its file system, to find the run of a file that was renamed while it grew. Only a
-- hint, as the whole table is.
ALTER TABLE source_file ADD COLUMN device INTEGER;
ALTER TABLE source_file ADD COLUMN inode INTEGER;

CREATE INDEX source_file_by_inode ON source_file (inode, device) WHERE inode IS NOT NULL;

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
       run.superseded_by_run_id
FROM run
JOIN robot USING (robot_id);
