DROP INDEX run_of_robot_by_start_text;
CREATE INDEX run_of_robot_by_start_text
ON run (robot_id, started_at_text, run_id, status, superseded_by_run_id, kind, model);

CREATE OR REPLACE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       run.started_at_text AS started_at,
       run.source_name,
       CASE WHEN NOT run.growing THEN encode(run.content_hash, 'hex') END AS content_hash,
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
       run.rows_skipped,
       (SELECT nullif(host_session.host, '') FROM host_session
        WHERE host_session.host_session_id = run.host_session_id) AS host
FROM run
JOIN robot USING (robot_id);
