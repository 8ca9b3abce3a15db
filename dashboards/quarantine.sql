-- Which exports were refused, with reason and place, and are they stored by now?
--
-- stored_run_id is the run of the corrected export under the same file name; the row here records the faulty content.
--
--   :robot        only this robot; default: all
--   :unresolved   1: only exports that are not stored yet
SELECT quarantine.robot,
       runs.started_at,
       run_id,
       quarantine.source_name,
       quarantine.problem,
       quarantine.line,
       quarantine.column_name,
       quarantine.value,
       quarantine.remedy,
       quarantine.cycles_stored,
       quarantine.first_at,
       quarantine.superseded_by_run_id AS stored_run_id
FROM quarantine
JOIN runs USING (run_id)
WHERE quarantine.state IN ('open', 'superseded')
  AND (nullif(:robot, '') IS NULL OR quarantine.robot = :robot)
  AND (coalesce(nullif(:unresolved, ''), '0') = '0' OR quarantine.state = 'open')
ORDER BY runs.started_at DESC, run_id DESC;
