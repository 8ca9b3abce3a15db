-- Which anomalies do the latest runs show, and since when? Worst first, with acknowledged and shelved ones.
--
-- score and threshold have the same scale; times_threshold is their ratio.
--
--   :robot           only this robot; default: all
--   :severity        info, warning or critical; default: all
--   :with_resolved   1: also resolved ones and false alarms
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
