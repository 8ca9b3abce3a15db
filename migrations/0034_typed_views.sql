-- Times as stored text, and views in words that other programs have too, so that every program sees the type of every
-- column. Some evaluate a view with functions of their own: where they lack one, such as strftime with 'unixepoch' or
-- iif, they take every column of the view for text, or refuse it.
--
-- Views therefore have no function but abs, count, group_concat, hex, ifnull, lower, max with one argument and nullif,
-- CASE where a condition is a number, and no syntax that is newer than STRICT tables.

-- RFC 3339 with milliseconds. The triggers below keep it up: who stores the integer stores nothing else. A later
-- migration that makes one of these tables anew makes its columns and its triggers anew.

ALTER TABLE run ADD COLUMN started_at_text TEXT;
ALTER TABLE run ADD COLUMN retry_asked_at_text TEXT;
ALTER TABLE cycle ADD COLUMN started_at_text TEXT;
ALTER TABLE fault ADD COLUMN first_at_text TEXT;
ALTER TABLE fault ADD COLUMN last_at_text TEXT;
ALTER TABLE dismissal ADD COLUMN dismissed_at_text TEXT;
ALTER TABLE conclusion_fault ADD COLUMN first_at_text TEXT;
ALTER TABLE conclusion_fault ADD COLUMN last_at_text TEXT;
ALTER TABLE anomaly ADD COLUMN first_seen_at_text TEXT;
ALTER TABLE anomaly ADD COLUMN last_seen_at_text TEXT;
ALTER TABLE anomaly ADD COLUMN onset_at_text TEXT;
ALTER TABLE anomaly ADD COLUMN shelved_until_text TEXT;
ALTER TABLE anomaly_event ADD COLUMN at_text TEXT;
ALTER TABLE maintenance ADD COLUMN at_text TEXT;
ALTER TABLE maintenance ADD COLUMN recorded_at_text TEXT;
ALTER TABLE friction_baseline ADD COLUMN begins_at_text TEXT;
ALTER TABLE friction_baseline ADD COLUMN formed_at_text TEXT;
ALTER TABLE friction_baseline ADD COLUMN replaced_at_text TEXT;
ALTER TABLE delivery ADD COLUMN due_at_text TEXT;
ALTER TABLE delivery ADD COLUMN attempted_at_text TEXT;
ALTER TABLE delivery ADD COLUMN sent_at_text TEXT;

UPDATE run
SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', started_at / 1000000.0, 'unixepoch'),
    retry_asked_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', retry_asked_at / 1000000.0, 'unixepoch');
UPDATE cycle
SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', started_at / 1000000.0, 'unixepoch');
UPDATE fault
SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', first_at / 1000000.0, 'unixepoch'),
    last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', last_at / 1000000.0, 'unixepoch');
UPDATE dismissal
SET dismissed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', dismissed_at / 1000000.0, 'unixepoch');
UPDATE conclusion_fault
SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', first_at / 1000000.0, 'unixepoch'),
    last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', last_at / 1000000.0, 'unixepoch');
UPDATE anomaly
SET first_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', first_seen_at / 1000000.0, 'unixepoch'),
    last_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', last_seen_at / 1000000.0, 'unixepoch'),
    onset_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', onset_at / 1000000.0, 'unixepoch'),
    shelved_until_text = strftime('%Y-%m-%dT%H:%M:%fZ', shelved_until / 1000000.0, 'unixepoch');
UPDATE anomaly_event
SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', at / 1000000.0, 'unixepoch');
UPDATE maintenance
SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', at / 1000000.0, 'unixepoch'),
    recorded_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', recorded_at / 1000000.0, 'unixepoch');
UPDATE friction_baseline
SET begins_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', begins_at / 1000000.0, 'unixepoch'),
    formed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', formed_at / 1000000.0, 'unixepoch'),
    replaced_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', replaced_at / 1000000.0, 'unixepoch');
UPDATE delivery
SET due_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', due_at / 1000000.0, 'unixepoch'),
    attempted_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', attempted_at / 1000000.0, 'unixepoch'),
    sent_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', sent_at / 1000000.0, 'unixepoch');

CREATE TRIGGER run_times_as_text AFTER INSERT ON run
BEGIN
    UPDATE run
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        retry_asked_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.retry_asked_at / 1000000.0, 'unixepoch')
    WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_times_change AFTER UPDATE OF started_at, retry_asked_at ON run
BEGIN
    UPDATE run
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        retry_asked_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.retry_asked_at / 1000000.0, 'unixepoch')
    WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER cycle_times_as_text AFTER INSERT ON cycle
BEGIN
    UPDATE cycle
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch')
    WHERE cycle_id = NEW.cycle_id;
END;
CREATE TRIGGER cycle_times_change AFTER UPDATE OF started_at ON cycle
BEGIN
    UPDATE cycle
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch')
    WHERE cycle_id = NEW.cycle_id;
END;

CREATE TRIGGER fault_times_as_text AFTER INSERT ON fault
BEGIN
    UPDATE fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE fault_id = NEW.fault_id;
END;
CREATE TRIGGER fault_times_change AFTER UPDATE OF first_at, last_at ON fault
BEGIN
    UPDATE fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE fault_id = NEW.fault_id;
END;

CREATE TRIGGER dismissal_times_as_text AFTER INSERT ON dismissal
BEGIN
    UPDATE dismissal
    SET dismissed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.dismissed_at / 1000000.0, 'unixepoch')
    WHERE dismissal_id = NEW.dismissal_id;
END;
CREATE TRIGGER dismissal_times_change AFTER UPDATE OF dismissed_at ON dismissal
BEGIN
    UPDATE dismissal
    SET dismissed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.dismissed_at / 1000000.0, 'unixepoch')
    WHERE dismissal_id = NEW.dismissal_id;
END;

CREATE TRIGGER conclusion_fault_times_as_text AFTER INSERT ON conclusion_fault
BEGIN
    UPDATE conclusion_fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE robot_id = NEW.robot_id;
END;
CREATE TRIGGER conclusion_fault_times_change AFTER UPDATE OF first_at, last_at ON conclusion_fault
BEGIN
    UPDATE conclusion_fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE robot_id = NEW.robot_id;
END;

CREATE TRIGGER anomaly_times_as_text AFTER INSERT ON anomaly
BEGIN
    UPDATE anomaly
    SET first_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_seen_at / 1000000.0, 'unixepoch'),
        last_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_seen_at / 1000000.0, 'unixepoch'),
        onset_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.onset_at / 1000000.0, 'unixepoch'),
        shelved_until_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.shelved_until / 1000000.0, 'unixepoch')
    WHERE anomaly_id = NEW.anomaly_id;
END;
CREATE TRIGGER anomaly_times_change AFTER UPDATE OF first_seen_at, last_seen_at, onset_at, shelved_until ON anomaly
BEGIN
    UPDATE anomaly
    SET first_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_seen_at / 1000000.0, 'unixepoch'),
        last_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_seen_at / 1000000.0, 'unixepoch'),
        onset_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.onset_at / 1000000.0, 'unixepoch'),
        shelved_until_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.shelved_until / 1000000.0, 'unixepoch')
    WHERE anomaly_id = NEW.anomaly_id;
END;

CREATE TRIGGER anomaly_event_times_as_text AFTER INSERT ON anomaly_event
BEGIN
    UPDATE anomaly_event
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch')
    WHERE anomaly_event_id = NEW.anomaly_event_id;
END;
CREATE TRIGGER anomaly_event_times_change AFTER UPDATE OF at ON anomaly_event
BEGIN
    UPDATE anomaly_event
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch')
    WHERE anomaly_event_id = NEW.anomaly_event_id;
END;

CREATE TRIGGER maintenance_times_as_text AFTER INSERT ON maintenance
BEGIN
    UPDATE maintenance
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch'),
        recorded_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.recorded_at / 1000000.0, 'unixepoch')
    WHERE maintenance_id = NEW.maintenance_id;
END;
CREATE TRIGGER maintenance_times_change AFTER UPDATE OF at, recorded_at ON maintenance
BEGIN
    UPDATE maintenance
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch'),
        recorded_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.recorded_at / 1000000.0, 'unixepoch')
    WHERE maintenance_id = NEW.maintenance_id;
END;

CREATE TRIGGER friction_baseline_times_as_text AFTER INSERT ON friction_baseline
BEGIN
    UPDATE friction_baseline
    SET begins_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.begins_at / 1000000.0, 'unixepoch'),
        formed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.formed_at / 1000000.0, 'unixepoch'),
        replaced_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.replaced_at / 1000000.0, 'unixepoch')
    WHERE friction_baseline_id = NEW.friction_baseline_id;
END;
CREATE TRIGGER friction_baseline_times_change AFTER UPDATE OF begins_at, formed_at, replaced_at ON friction_baseline
BEGIN
    UPDATE friction_baseline
    SET begins_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.begins_at / 1000000.0, 'unixepoch'),
        formed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.formed_at / 1000000.0, 'unixepoch'),
        replaced_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.replaced_at / 1000000.0, 'unixepoch')
    WHERE friction_baseline_id = NEW.friction_baseline_id;
END;

CREATE TRIGGER delivery_times_as_text AFTER INSERT ON delivery
BEGIN
    UPDATE delivery
    SET due_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.due_at / 1000000.0, 'unixepoch'),
        attempted_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.attempted_at / 1000000.0, 'unixepoch'),
        sent_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.sent_at / 1000000.0, 'unixepoch')
    WHERE delivery_id = NEW.delivery_id;
END;
CREATE TRIGGER delivery_times_change AFTER UPDATE OF due_at, attempted_at, sent_at ON delivery
BEGIN
    UPDATE delivery
    SET due_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.due_at / 1000000.0, 'unixepoch'),
        attempted_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.attempted_at / 1000000.0, 'unixepoch'),
        sent_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.sent_at / 1000000.0, 'unixepoch')
    WHERE delivery_id = NEW.delivery_id;
END;

-- The contract -------------------------------------------------------------------------------------
-- Names, order and values of all columns are as before.

DROP VIEW runs;

CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       run.started_at_text AS started_at,
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

DROP VIEW cycles;

CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       cycle.started_at_text AS started_at,
       cycle.duration_s,
       cycle.rows,
       CASE WHEN cycle.doubtful THEN 'doubtful' ELSE cycle.status END AS status,
       cycle.reason,
       cycle.remarks,
       cycle.sample_rate_hz,
       cycle.cutoff_hz,
       cycle.samples,
       cycle.condition_number,
       cycle.scaled_condition_number,
       cycle.residual_std_nm,
       cycle.estimator,
       cycle.error_basis,
       cycle.estimator_reason
FROM cycle
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW quarantine;

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
           WHEN dismissal.dismissal_id IS NOT NULL THEN 'dismissed'
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
       fault.first_at_text AS first_at,
       fault.last_at_text AS last_at,
       run.retry_asked_at_text AS retry_asked_at,
       run.superseded_by_run_id,
       fault.fault_id,
       dismissal.dismissed_at_text AS dismissed_at,
       dismissal.dismissed_by,
       dismissal.reason AS dismissal_reason
FROM fault
JOIN run USING (run_id)
JOIN robot USING (robot_id)
LEFT JOIN dismissal ON dismissal.fault_id = fault.fault_id AND dismissal.withdrawn_at IS NULL;

DROP VIEW conclusion_faults;

CREATE VIEW conclusion_faults AS
SELECT robot.name AS robot,
       conclusion_fault.reason,
       conclusion_fault.tries,
       conclusion_fault.first_at_text AS first_at,
       conclusion_fault.last_at_text AS last_at
FROM conclusion_fault
JOIN robot USING (robot_id);

DROP VIEW cycle_parameters;

-- nullif, because a quotient by zero is NULL in SQLite and infinity elsewhere.
CREATE VIEW cycle_parameters AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       model_parameter.joint,
       model_parameter.name AS parameter,
       cycle_parameter.value,
       cycle_parameter.std_error,
       model_parameter.unit,
       model_parameter.grouping,
       cycle_parameter.std_error / nullif(abs(cycle_parameter.value), 0) AS relative_std_error,
       cycle_parameter.degrees_of_freedom,
       cycle_parameter.value - cycle_parameter.half_width_95 AS interval_low,
       cycle_parameter.value + cycle_parameter.half_width_95 AS interval_high
FROM cycle_parameter
JOIN model_parameter USING (model_parameter_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW friction_map;

CREATE VIEW friction_map AS
SELECT robot.name AS robot,
       law.joint,
       level.speed_fraction,
       level.warm_nm,
       level.warm_std_error_nm,
       level.cold_nm,
       level.cold_std_error_nm,
       CASE WHEN law.thermal_source <> 'motor_temperature' THEN law.slow_min END AS slow_min,
       CASE WHEN law.thermal_source <> 'motor_temperature' THEN law.slow_std_error_min END AS slow_std_error_min,
       law.fast_min,
       law.fast_std_error_min,
       law.slow_share,
       law.slow_share_std_error,
       law.cooling_ratio,
       law.cooling_ratio_std_error,
       law.explained,
       law.relative_rmsd,
       law.runs,
       law.points,
       law.remarks,
       law.thermal_source,
       law.warm_degc,
       law.cold_degc,
       law.curvature,
       law.curvature_std_error,
       law.ambient_degc,
       law.coldness_1_k,
       law.coldness_std_error_1_k
FROM friction_law AS law
JOIN friction_level AS level USING (robot_id, joint)
JOIN robot USING (robot_id);

DROP VIEW friction_index;

CREATE VIEW friction_index AS
SELECT robot.name AS robot,
       found.run_id,
       run.started_at_text AS started_at,
       found.joint,
       found.friction_index,
       found.friction_index_std_error,
       found.ambient_coldness,
       found.ambient_coldness_std_error,
       found.coldness_at_start,
       found.points,
       found.raw_index,
       found.short_run
FROM run_friction_index AS found
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW temperatures;

CREATE VIEW temperatures AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       ((cycle.started_at - run.started_at) / 1000000.0 + 0.5 * cycle.duration_s) / 60.0 AS minute,
       CASE WHEN found.joint = 0 THEN 'ambient' ELSE 'motor' END AS sensor,
       nullif(found.joint, 0) AS joint,
       found.temperature_degc
FROM cycle_temperature AS found
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

DROP VIEW baselines;

CREATE VIEW baselines AS
SELECT robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       baseline.begins_at_text AS begins_at,
       of_run.run_id,
       run.started_at_text AS started_at,
       baseline.levels,
       baseline.remark
FROM friction_baseline AS baseline
JOIN robot USING (robot_id)
JOIN friction_baseline_run AS of_run USING (friction_baseline_id)
LEFT JOIN run ON run.run_id = of_run.run_id
WHERE baseline.replaced_at IS NULL;

DROP VIEW baseline_changes;

CREATE VIEW baseline_changes AS
SELECT baseline.friction_baseline_id,
       robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       baseline.begins_at_text AS begins_at,
       '[' || ifnull((SELECT group_concat(of_run.run_id, ',') FROM friction_baseline_run AS of_run
                      WHERE of_run.friction_baseline_id = baseline.friction_baseline_id), '') || ']' AS run_ids,
       baseline.formed_at_text AS formed_at,
       baseline.replaced_at_text AS replaced_at,
       baseline.replaced_because
FROM friction_baseline AS baseline
JOIN robot USING (robot_id);

DROP VIEW anomalies;

CREATE VIEW anomalies AS
SELECT anomaly.anomaly_id,
       robot.name AS robot,
       anomaly.first_run_id AS run_id,
       anomaly.first_cycle AS cycle,
       anomaly.joint,
       anomaly.kind,
       anomaly.quantity,
       anomaly.severity,
       anomaly.score,
       anomaly.threshold,
       anomaly.value,
       anomaly.baseline,
       anomaly.first_seen_at_text AS first_seen_at,
       anomaly.last_seen_at_text AS last_seen_at,
       anomaly.state,
       anomaly.message,
       anomaly.last_run_id,
       anomaly.peak_value,
       anomaly.onset_at_text AS onset_at,
       anomaly.onset_run_id,
       anomaly.onset_cycle,
       anomaly.odds,
       anomaly.alternatives,
       anomaly.peak_score,
       anomaly.shelved_until_text AS shelved_until,
       anomaly.ended,
       CASE WHEN anomaly.open_run_id IS NULL THEN 0 ELSE 1 END AS provisional
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;

DROP VIEW anomaly_history;

CREATE VIEW anomaly_history AS
SELECT anomaly_event.anomaly_event_id,
       anomaly_event.anomaly_id,
       robot.name AS robot,
       anomaly.joint,
       anomaly.kind,
       anomaly_event.at_text AS at,
       anomaly_event.what,
       anomaly_event.severity,
       anomaly_event.score,
       anomaly_event.value,
       anomaly_event.message,
       anomaly_event.who,
       anomaly_event.why,
       anomaly_event.run_id
FROM anomaly_event
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id);

DROP VIEW maintenance_log;

CREATE VIEW maintenance_log AS
SELECT maintenance.maintenance_id,
       robot.name AS robot,
       maintenance.joint,
       maintenance.at_text AS at,
       maintenance.what,
       maintenance.who,
       maintenance.recorded_at_text AS recorded_at
FROM maintenance
JOIN robot USING (robot_id);

DROP VIEW deliveries;

CREATE VIEW deliveries AS
SELECT delivery.delivery_id,
       delivery_route.name AS route,
       'armwatch-' || database_identity.identity || '-' || delivery.anomaly_event_id AS key,
       anomaly_event.anomaly_id,
       delivery.anomaly_event_id,
       robot.name AS robot,
       anomaly.joint,
       anomaly_event.what,
       anomaly_event.severity,
       delivery.state,
       delivery.held,
       delivery.digest,
       delivery.due_at_text AS due_at,
       delivery.attempts,
       delivery.attempted_at_text AS attempted_at,
       delivery.sent_at_text AS sent_at,
       delivery.error
FROM delivery
JOIN delivery_route USING (delivery_route_id)
JOIN anomaly_event USING (anomaly_event_id)
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id)
CROSS JOIN database_identity;

DROP VIEW production_checks;

CREATE VIEW production_checks AS
SELECT run.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       cycle.started_at_text AS started_at,
       cycle.duration_s,
       cycle.rows,
       production_check.joint,
       production_check.reference_run_id,
       production_check.moving_relative_rmsd,
       production_check.moving_rmsd_nm,
       production_check.relative_rmsd,
       production_check.rmsd_nm,
       production_check.friction_excess,
       production_check.friction_share,
       production_check.moving_samples,
       production_check.samples,
       CASE WHEN production_check.joint IS NULL THEN ifnull(cycle.reason, 'no model yet') END AS reason,
       production_check.estimator
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;

DROP VIEW production_trend;

CREATE VIEW production_trend AS
SELECT robot.name AS robot,
       run.run_id,
       run.started_at_text AS started_at,
       production_summary.joint,
       production_summary.reference_run_id,
       production_summary.windows,
       production_summary.relative_rmsd AS moving_relative_rmsd,
       production_summary.friction_excess,
       production_summary.friction_share,
       of_test.relative_rmsd AS test_relative_rmsd
FROM production_summary
JOIN run USING (run_id)
JOIN robot USING (robot_id)
LEFT JOIN run_joint_summary AS of_test
          ON of_test.run_id = production_summary.reference_run_id AND of_test.joint = production_summary.joint
WHERE run.superseded_by_run_id IS NULL;

DROP VIEW fleet_health;

CREATE VIEW fleet_health AS
WITH latest AS (
    SELECT robot.robot_id, robot.name AS robot, robot.expected_by, robot.overdue, run.run_id, run.started_at,
           run.started_at_text
    FROM robot
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = robot.robot_id AND newest.status = 'complete' AND newest.kind = 'test'
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
-- the newest export that was not understood, where no test is as new
faulty AS (
    SELECT latest.robot_id, run.source_name, run.reason
    FROM latest
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = latest.robot_id AND newest.status = 'quarantined' AND newest.kind = 'test'
              AND newest.superseded_by_run_id IS NULL AND newest.started_at > latest.started_at
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
member AS (
    SELECT latest.robot_id, run_joint_summary.joint FROM latest JOIN run_joint_summary USING (run_id)
    UNION
    SELECT latest.robot_id, joint_health.joint FROM latest JOIN joint_health USING (robot_id)
),
-- anomalies of the whole arm are every joint's
trouble AS (
    SELECT member.robot_id, member.joint,
           count(CASE WHEN anomaly.state = 'open' THEN 1 END) AS open_anomalies,
           max(CASE WHEN anomaly.severity = 'critical' THEN 1 ELSE 0 END) AS critical,
           max(CASE WHEN anomaly.severity = 'warning' THEN 1 ELSE 0 END) AS warning
    FROM member
    JOIN anomaly ON anomaly.robot_id = member.robot_id AND ifnull(anomaly.joint, member.joint) = member.joint
    WHERE anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
    GROUP BY member.robot_id, member.joint
),
judged AS (
    SELECT latest.robot_id,
           latest.robot,
           latest.run_id,
           latest.started_at_text,
           latest.expected_by,
           member.joint,
           joint_health.friction_index,
           joint_health.friction_quantity,
           joint_health.reason,
           joint_health.last_result_run_id,
           joint_health.trend,
           joint_health.warning_by,
           joint_health.warning_by_lower,
           joint_health.warning_by_upper,
           joint_health.critical_by,
           joint_health.critical_by_lower,
           joint_health.critical_by_upper,
           ifnull(trouble.open_anomalies, 0) AS open_anomalies,
           faulty.source_name AS faulty_name,
           faulty.reason AS faulty_reason,
           conclusion_fault.reason AS not_concluded,
           CASE
               WHEN faulty.robot_id IS NOT NULL OR conclusion_fault.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'no_result' THEN 'unknown'
               WHEN trouble.critical = 1 THEN 'critical'
               WHEN trouble.warning = 1 THEN 'warning'
               WHEN joint_health.knowledge = 'unsettled' THEN 'unknown'
               WHEN latest.overdue = 1 THEN 'overdue'
               WHEN ifnull(joint_health.knowledge, 'learning') = 'learning' THEN 'learning'
               ELSE 'ok'
           END AS status
    FROM member
    JOIN latest ON latest.robot_id = member.robot_id
    LEFT JOIN faulty ON faulty.robot_id = member.robot_id
    LEFT JOIN conclusion_fault ON conclusion_fault.robot_id = member.robot_id
    LEFT JOIN joint_health ON joint_health.robot_id = member.robot_id AND joint_health.joint = member.joint
    LEFT JOIN trouble ON trouble.robot_id = member.robot_id AND trouble.joint = member.joint
)
SELECT judged.robot,
       judged.joint,
       judged.started_at_text AS last_run_at,
       run_joint_summary.relative_rmsd AS moving_relative_rmsd,
       judged.friction_index,
       judged.open_anomalies,
       judged.status,
       result.started_at_text AS last_result_at,
       CASE
           WHEN judged.faulty_name IS NOT NULL
               THEN 'the latest export, ' || judged.faulty_name || ', is in quarantine: ' || judged.faulty_reason
           WHEN judged.not_concluded IS NOT NULL
               THEN 'nothing is concluded of the latest tests: ' || judged.not_concluded
           WHEN judged.status IN ('critical', 'warning') OR judged.status = 'ok' AND judged.reason IS NULL THEN (
               SELECT anomaly.message FROM anomaly
               WHERE anomaly.robot_id = judged.robot_id AND ifnull(anomaly.joint, judged.joint) = judged.joint
                     AND anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
               ORDER BY anomaly.severity = 'critical' DESC, anomaly.severity = 'warning' DESC,
                        anomaly.last_seen_at DESC, anomaly.anomaly_id DESC
               LIMIT 1
           )
           WHEN judged.status = 'overdue'
               THEN 'no test since that of ' || judged.started_at_text
                    || '; the next was expected by ' || judged.expected_by
           ELSE judged.reason
       END AS reason,
       judged.expected_by,
       judged.friction_quantity,
       judged.trend,
       judged.warning_by,
       judged.warning_by_lower,
       judged.warning_by_upper,
       judged.critical_by,
       judged.critical_by_lower,
       judged.critical_by_upper
FROM judged
LEFT JOIN run_joint_summary
       ON run_joint_summary.run_id = judged.run_id AND run_joint_summary.joint = judged.joint
LEFT JOIN run AS result ON result.run_id = judged.last_result_run_id;
