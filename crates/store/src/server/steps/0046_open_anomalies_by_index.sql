-- Anomalies in one state, for counts and lists of open ones.
CREATE INDEX anomaly_by_state ON anomaly (state, robot_id, severity) WHERE NOT withdrawn;
-- Anomalies of a robot that say where its joints stand: the view fleet_health asks in these words.
CREATE INDEX anomaly_in_force ON anomaly (robot_id, joint)
WHERE state NOT IN ('resolved', 'false_alarm') AND NOT withdrawn;

-- Cycles of another estimator that are marked as kept stand apart from those that are to be looked at.
DROP INDEX cycle_by_estimator;
CREATE INDEX cycle_by_estimator ON cycle (estimator, estimator_wanted, run_id) WHERE samples IS NOT NULL;
