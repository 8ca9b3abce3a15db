-- Bad rows that the layout let be passed over (skip_bad under [rows]), beyond those in rows; NULL until the run is
-- complete, and in runs that earlier versions stored, which passed over none.
ALTER TABLE run ADD COLUMN rows_skipped INTEGER CHECK (rows_skipped >= 0);

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
       run.kind,
       run.rows_skipped
FROM run
JOIN robot USING (robot_id);
