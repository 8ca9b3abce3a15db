-- What is wrong now, and since when? Anomalies that the latest runs still show, worst first;
-- acknowledged and shelved ones are known to somebody, not gone.
--
-- score and threshold are in one scale, so times_threshold tells how far out a joint is.
--
--   :robot           only this robot; all if left out
--   :severity        info, warning or critical: only this severity; all if left out
--   :with_resolved   1: the resolved ones and false alarms too
SELECT severity,
       robot,
       joint,
       kind,
       quantity,
       message,
       first_seen_at,
       last_seen_at,
       state,
       value,
       baseline,
       score / threshold AS times_threshold,
       run_id AS first_run_id,
       last_run_id,
       anomaly_id
FROM anomalies
WHERE (state NOT IN ('resolved', 'false_alarm') OR coalesce(nullif(:with_resolved, ''), '0') <> '0')
  AND (nullif(:robot, '') IS NULL OR robot = :robot)
  AND (nullif(:severity, '') IS NULL OR severity = :severity)
ORDER BY state IN ('resolved', 'false_alarm'),
         CASE severity WHEN 'critical' THEN 0 WHEN 'warning' THEN 1 ELSE 2 END,
         last_seen_at DESC, robot, joint;
