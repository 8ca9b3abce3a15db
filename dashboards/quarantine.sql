-- Which exports were not understood, why and where, and are they stored meanwhile?
--
-- stored_run_id is a complete run of the same file name and robot: the export was corrected and
-- taken, and the row here only remembers the faulty content.
--
--   :robot        only this robot; all if left out
--   :unresolved   1: only exports that are not stored meanwhile
WITH faulty AS (
    SELECT runs.*,
           (SELECT max(other.run_id) FROM runs AS other
            WHERE other.status = 'complete' AND other.source_name = runs.source_name
              AND other.robot = runs.robot) AS stored_run_id
    FROM runs
    WHERE runs.status = 'quarantined'
)
SELECT robot,
       started_at,
       run_id,
       source_name,
       reason,
       reason_line,
       reason_column,
       cycles AS cycles_stored,
       stored_run_id
FROM faulty
WHERE (nullif(:robot, '') IS NULL OR robot = :robot)
  AND (coalesce(nullif(:unresolved, ''), '0') = '0' OR stored_run_id IS NULL)
ORDER BY started_at DESC, run_id DESC;
