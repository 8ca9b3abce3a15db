-- Which exports were not understood, why and where, and are they stored meanwhile?
--
-- stored_run_id is the run that a corrected export became, under the same file name: the row here only
-- remembers the faulty content.
--
--   :robot        only this robot; all if left out
--   :unresolved   1: only exports that are not stored meanwhile
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
