-- The public views, as docs/schema.md describes them, in SQL that SQLite, PostgreSQL and DuckDB understand. A flag is
-- cast to INTEGER, since PostgreSQL has it as boolean. Text after `--server` counts on a server only.

CREATE VIEW friction_points AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       friction_point.time_s / 60.0 AS minute,
       friction_point.joint,
       friction_point.speed_fraction,
       friction_point.speed_rad_s,
       friction_point.direction,
       friction_point.torque_nm,
       friction_point.std_nm,
       friction_point.samples,
       friction_point.gravity,
       friction_point.load_nm,
       friction_point.load_friction
FROM friction_point
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW parameter_statistics AS
SELECT robot.name AS robot,
       parameter_statistic.run_id,
       model_parameter.joint,
       model_parameter.name AS parameter,
       parameter_statistic."window",
       parameter_statistic.mean,
       parameter_statistic.min,
       parameter_statistic.max,
       parameter_statistic.d_mm,
       parameter_statistic.d_se,
       parameter_statistic.sdv,
       parameter_statistic.cycles
FROM parameter_statistic
JOIN model_parameter USING (model_parameter_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW parameter_set_sources AS
SELECT parameter_set.name AS parameter_set,
       parameter_set_source.robot,
       parameter_set_source.run_id,
       parameter_set_source.cycle
FROM parameter_set_source
JOIN parameter_set USING (parameter_set_id);

CREATE VIEW joint_residuals AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       joint_residual.joint,
       joint_residual.residual_std_nm,
       joint_residual.independent_share
FROM joint_residual
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW torque_noise AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       channel_noise.joint,
       channel_noise.noise_nm,
       channel_noise.relative_noise
FROM channel_noise
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW parameter_sets AS
SELECT parameter_set.name AS parameter_set,
       robot_model.name AS model,
       model_parameter.joint,
       model_parameter.name AS parameter,
       parameter_set_value.value,
       parameter_set_value.std_error,
       model_parameter.unit,
       model_parameter.grouping,
       (SELECT count(*) FROM parameter_set_source
        WHERE parameter_set_source.parameter_set_id = parameter_set.parameter_set_id) AS cycles,
       parameter_set.samples,
       parameter_set.condition_number,
       parameter_set.scaled_condition_number,
       parameter_set.residual_std_nm,
       parameter_set.estimator,
       parameter_set.error_basis
FROM parameter_set
JOIN robot_model USING (robot_model_id)
JOIN parameter_set_value USING (parameter_set_id)
JOIN model_parameter USING (model_parameter_id);

CREATE VIEW reestimated_cycles AS
SELECT reestimate.name AS estimate,
       reestimate.estimator,
       reestimate_cycle.robot,
       reestimate_cycle.run_id,
       reestimate_cycle.cycle,
       nullif(reestimate_view.seen_by_joint, 0) AS seen_by_joint,
       reestimate_view.samples,
       reestimate_view.condition_number,
       reestimate_view.scaled_condition_number,
       reestimate_view.residual_std_nm,
       reestimate_cycle.reason
FROM reestimate
JOIN reestimate_cycle USING (reestimate_id)
LEFT JOIN reestimate_view USING (reestimate_cycle_id);

CREATE VIEW reestimated_parameters AS
SELECT reestimate.name AS estimate,
       reestimate_cycle.robot,
       reestimate_cycle.run_id,
       reestimate_cycle.cycle,
       nullif(reestimate_value.seen_by_joint, 0) AS seen_by_joint,
       model_parameter.joint,
       model_parameter.name AS parameter,
       reestimate_value.value,
       reestimate_value.std_error,
       reestimate_value.value - reestimate_value.half_width_95 AS interval_low,
       reestimate_value.value + reestimate_value.half_width_95 AS interval_high,
       reestimate_value.data_share,
       model_parameter.unit,
       model_parameter.grouping
FROM reestimate
JOIN reestimate_cycle USING (reestimate_id)
JOIN reestimate_value USING (reestimate_cycle_id)
JOIN model_parameter USING (model_parameter_id);

CREATE VIEW reestimated_statistics AS
SELECT reestimate.name AS estimate,
       reestimate_statistic.robot,
       reestimate_statistic.run_id,
       nullif(reestimate_statistic.seen_by_joint, 0) AS seen_by_joint,
       model_parameter.joint,
       model_parameter.name AS parameter,
       reestimate_statistic."window",
       reestimate_statistic.mean,
       reestimate_statistic.min,
       reestimate_statistic.max,
       reestimate_statistic.d_mm,
       reestimate_statistic.d_se,
       reestimate_statistic.sdv,
       reestimate_statistic.cycles
FROM reestimate
JOIN reestimate_statistic USING (reestimate_id)
JOIN model_parameter USING (model_parameter_id);

CREATE VIEW friction_speed_fits AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       fit.joint,
       fit.direction,
       fit.model,
       coefficient.name AS coefficient,
       coefficient.value,
       coefficient.std_error,
       CAST(coefficient.at_bound AS INTEGER) AS at_bound,
       fit.slowest_rad_s,
       fit.fastest_rad_s,
       fit.rmsd_nm,
       fit.reduced_chi_square,
       fit.points,
       fit.asymmetry_nm,
       fit.asymmetry_std_error_nm
FROM friction_speed_fit AS fit
JOIN friction_speed_coefficient AS coefficient USING (friction_speed_fit_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW cycle_rmsd AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       torque_rmsd.joint,
       torque_rmsd.stage,
       torque_rmsd.verification,
       torque_rmsd.reference_run_id,
       torque_rmsd.rmsd_nm,
       torque_rmsd.relative_rmsd,
       torque_rmsd.moving_rmsd_nm,
       torque_rmsd.moving_relative_rmsd,
       torque_rmsd.samples,
       torque_rmsd.moving_samples,
       coalesce(torque_rmsd.estimator, cycle.estimator) AS estimator
FROM torque_rmsd
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW warming_contrast AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       first_third.joint,
       first_third.rmsd_nm AS start_rmsd_nm,
       last_third.rmsd_nm AS end_rmsd_nm,
       first_third.relative_rmsd AS start_relative_rmsd,
       last_third.relative_rmsd AS end_relative_rmsd,
       first_third.moving_rmsd_nm AS start_moving_rmsd_nm,
       last_third.moving_rmsd_nm AS end_moving_rmsd_nm,
       first_third.moving_relative_rmsd AS start_moving_relative_rmsd,
       last_third.moving_relative_rmsd AS end_moving_relative_rmsd,
       first_third.samples AS start_samples,
       last_third.samples AS end_samples,
       first_third.moving_samples AS start_moving_samples,
       last_third.moving_samples AS end_moving_samples,
       coalesce(first_third.estimator, cycle.estimator) AS estimator
FROM warming_rmsd AS first_third
JOIN warming_rmsd AS last_third
     ON last_third.cycle_id = first_third.cycle_id AND last_third.joint = first_third.joint AND last_third.part = 'end'
JOIN cycle ON cycle.cycle_id = first_third.cycle_id
JOIN run USING (run_id)
JOIN robot USING (robot_id)
WHERE first_third.part = 'start';

CREATE VIEW warmup_fits AS
SELECT robot.name AS robot,
       warmup_fit.run_id,
       warmup_fit.joint,
       warmup_fit.speed_fraction,
       warmup_fit.model,
       warmup_fit.a_nm,
       warmup_fit.b_nm,
       warmup_fit.t1_min,
       warmup_fit.c_nm,
       warmup_fit.t2_min,
       warmup_fit.a_std_error_nm,
       warmup_fit.b_std_error_nm,
       warmup_fit.t1_std_error_min,
       warmup_fit.c_std_error_nm,
       warmup_fit.t2_std_error_min,
       warmup_fit.rmsd_nm,
       warmup_fit.samples,
       warmup_fit.first_min,
       warmup_fit.last_min,
       CAST(warmup_fit.a_extrapolated AS INTEGER) AS a_extrapolated,
       warmup_fit.c_first_nm,
       warmup_fit.c_first_std_error_nm,
       warmup_fit.t2_max_min
FROM warmup_fit
JOIN robot USING (robot_id);

CREATE VIEW cycle_friction AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       level.joint,
       level.minute,
       level.ln_torque,
       level.offset_nm,
       level.levels,
       level.speed_fraction
FROM cycle_friction_level AS level
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW blocked_files AS
SELECT blocked_file.robot,
       blocked_file.source_name,
       blocked_file.path AS source_path,
       blocked_file.run_id,
       blocked_file.line,
       blocked_file.problem,
       blocked_file.remedy,
       blocked_file.blocked_at,
       CASE WHEN blocked_file.line IS NULL THEN 'cannot be read since '
            ELSE 'cannot be read beyond line ' || blocked_file.line || ' since ' END
           || substr(blocked_file.blocked_at, 1, 10) || ' ' || substr(blocked_file.blocked_at, 12, 5) || 'Z'
           || ': ' || blocked_file.problem AS message
FROM blocked_file;

CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       run.started_at_text AS started_at,
       run.source_name,
       CASE WHEN NOT run.growing THEN lower(hex(run.content_hash)) END AS content_hash,
       run.rows,
       run.sample_rate_hz,
       run.cycles_stored AS cycles,
       CASE WHEN run.superseded_by_run_id IS NULL THEN run.status
            WHEN run.superseded_by_run_id = run.run_id THEN 'set_aside' ELSE 'superseded' END AS status,
       coalesce(run.reason, (SELECT blocked_files.message FROM blocked_files
                             WHERE blocked_files.run_id = run.run_id AND run.status = 'streaming')) AS reason,
       coalesce(run.reason_line, (SELECT blocked_file.line FROM blocked_file
                                  WHERE blocked_file.run_id = run.run_id AND run.status = 'streaming')) AS reason_line,
       run.reason_column,
       run.model,
       nullif(run.superseded_by_run_id, run.run_id) AS superseded_by_run_id,
       run.kind,
       run.rows_skipped,
       (SELECT nullif(host_session.host, '') FROM host_session
        WHERE host_session.host_session_id = run.host_session_id) AS host,
       (SELECT blocked_file.blocked_at FROM blocked_file
        WHERE blocked_file.run_id = run.run_id AND run.status = 'streaming') AS blocked_at,
       run.date_problem,
       run.recorded_start_text AS recorded_start_at
FROM run
JOIN robot USING (robot_id);

CREATE VIEW hosts AS
SELECT latest.host,
       CASE WHEN latest.ended_at IS NOT NULL THEN 'ended'
            --server WHEN latest.alive_until < clock_us() THEN 'silent'
            ELSE 'at_work' END AS state,
       latest.end_reason,
       latest.version,
       latest.started_at_text AS started_at,
       latest.seen_at_text AS seen_at,
       (SELECT count(*) FROM claim
        WHERE claim.host_session_id = latest.host_session_id AND claim.kind = 'run') AS runs_in_work,
       (SELECT count(*) FROM host_session AS own JOIN run USING (host_session_id) WHERE own.host = latest.host) AS runs
FROM host_session AS latest
WHERE latest.kind = 'daemon'
  AND latest.host_session_id = (SELECT max(own.host_session_id) FROM host_session AS own
                                WHERE own.host = latest.host AND own.kind = 'daemon');

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

CREATE VIEW conclusion_faults AS
SELECT robot.name AS robot,
       conclusion_fault.reason,
       conclusion_fault.tries,
       conclusion_fault.first_at_text AS first_at,
       conclusion_fault.last_at_text AS last_at
FROM conclusion_fault
JOIN robot USING (robot_id);

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
       CAST(found.short_run AS INTEGER) AS short_run
FROM run_friction_index AS found
JOIN run USING (run_id)
JOIN robot USING (robot_id);

CREATE VIEW temperatures AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       (CAST(cycle.started_at - run.started_at AS DOUBLE PRECISION) / 1000000.0 + 0.5 * cycle.duration_s) / 60.0
           AS minute,
       CASE WHEN found.joint = 0 THEN 'ambient' ELSE 'motor' END AS sensor,
       nullif(found.joint, 0) AS joint,
       found.temperature_degc
FROM cycle_temperature AS found
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

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

CREATE VIEW baseline_changes AS
SELECT baseline.friction_baseline_id,
       robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       baseline.begins_at_text AS begins_at,
       '[' || coalesce((SELECT group_concat(CAST(of_run.run_id AS TEXT), ','
                                            --server ORDER BY of_run.run_id
                        )
                        FROM friction_baseline_run AS of_run
                        WHERE of_run.friction_baseline_id = baseline.friction_baseline_id), '') || ']' AS run_ids,
       baseline.formed_at_text AS formed_at,
       baseline.replaced_at_text AS replaced_at,
       baseline.replaced_because
FROM friction_baseline AS baseline
JOIN robot USING (robot_id);

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
       CAST(anomaly.ended AS INTEGER) AS ended,
       CASE WHEN anomaly.open_run_id IS NULL THEN 0 ELSE 1 END AS provisional,
       unit_of[anomaly.quantity] AS unit,
       anomaly.assignee
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;

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
       anomaly_event.run_id,
       coalesce(anomaly_event.quantity, anomaly.quantity) AS quantity,
       unit_of[coalesce(anomaly_event.quantity, anomaly.quantity)] AS unit
FROM anomaly_event
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id);

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

CREATE VIEW maintenance_windows AS
SELECT planned.maintenance_window_id,
       robot.name AS robot,
       planned.joint,
       planned.from_at_text AS from_at,
       planned.until_at_text AS until_at,
       planned.what,
       planned.who,
       planned.recorded_at_text AS recorded_at
FROM maintenance_window AS planned
JOIN robot USING (robot_id);

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
       CASE WHEN production_check.joint IS NULL THEN coalesce(cycle.reason, 'no model yet') END AS reason,
       production_check.estimator
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;

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
-- the newest export in quarantine, if no test is as new
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
-- a growing export that cannot be read beyond a line
blocked AS (
    SELECT latest.robot_id, blocked_files.source_name, blocked_files.message
    FROM latest
    JOIN blocked_files ON blocked_files.robot = latest.robot
    WHERE NOT EXISTS (SELECT 1 FROM blocked_file AS later
                      WHERE later.robot = latest.robot AND later.path > blocked_files.source_path)
),
-- the tests that arrived last, where their dates cannot be right
misdated AS (
    SELECT latest.robot_id, run.source_name, run.date_problem
    FROM latest
    JOIN run ON run.run_id = (
        SELECT max(own.run_id) FROM run AS own
        WHERE own.robot_id = latest.robot_id AND own.set_aside IN ('implausible_date', 'arrival_order')
    )
    WHERE run.kind = 'test' AND NOT EXISTS (
        SELECT 1 FROM run AS later
        WHERE later.robot_id = latest.robot_id AND later.status = 'complete' AND later.kind = 'test'
              AND later.set_aside IS NULL AND later.run_id > run.run_id
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
    JOIN anomaly ON anomaly.robot_id = member.robot_id AND coalesce(anomaly.joint, member.joint) = member.joint
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
           coalesce(trouble.open_anomalies, 0) AS open_anomalies,
           faulty.source_name AS faulty_name,
           faulty.reason AS faulty_reason,
           conclusion_fault.reason AS not_concluded,
           blocked.source_name AS blocked_name,
           blocked.message AS blocked_message,
           misdated.source_name AS misdated_name,
           misdated.date_problem,
           CASE
               WHEN faulty.robot_id IS NOT NULL OR conclusion_fault.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'no_result' THEN 'unknown'
               WHEN trouble.critical = 1 THEN 'critical'
               WHEN trouble.warning = 1 THEN 'warning'
               WHEN blocked.robot_id IS NOT NULL OR misdated.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'unsettled' THEN 'unknown'
               WHEN latest.overdue THEN 'overdue'
               WHEN coalesce(joint_health.knowledge, 'learning') = 'learning' THEN 'learning'
               ELSE 'ok'
           END AS status
    FROM member
    JOIN latest ON latest.robot_id = member.robot_id
    LEFT JOIN faulty ON faulty.robot_id = member.robot_id
    LEFT JOIN conclusion_fault ON conclusion_fault.robot_id = member.robot_id
    LEFT JOIN blocked ON blocked.robot_id = member.robot_id
    LEFT JOIN misdated ON misdated.robot_id = member.robot_id
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
           WHEN judged.status = 'unknown' AND judged.blocked_name IS NOT NULL
               THEN judged.blocked_name || ' ' || judged.blocked_message
           WHEN judged.status = 'unknown' AND judged.misdated_name IS NOT NULL
               THEN 'the date of the latest test, ' || judged.misdated_name || ', cannot be right: it is '
                    || judged.date_problem || '; judged by the tests until '
                    || substr(coalesce(result.started_at_text, judged.started_at_text), 1, 10)
                    || ' ' || substr(coalesce(result.started_at_text, judged.started_at_text), 12, 5) || 'Z'
           WHEN judged.status IN ('critical', 'warning') OR judged.status = 'ok' AND judged.reason IS NULL THEN (
               SELECT anomaly.message FROM anomaly
               WHERE anomaly.robot_id = judged.robot_id AND coalesce(anomaly.joint, judged.joint) = judged.joint
                     AND anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
               ORDER BY anomaly.severity = 'critical' DESC, anomaly.severity = 'warning' DESC,
                        anomaly.last_seen_at DESC, anomaly.anomaly_id DESC
               LIMIT 1
           )
           WHEN judged.status = 'overdue'
               THEN 'no test since that of '
                    || substr(judged.started_at_text, 1, 10) || ' ' || substr(judged.started_at_text, 12, 5)
                    || 'Z; the next was expected by '
                    || substr(judged.expected_by, 1, 10) || ' ' || substr(judged.expected_by, 12, 5) || 'Z'
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

CREATE VIEW view_columns AS
SELECT view_name,
       column_name,
       position,
       type,
       unit,
       CASE WHEN null_when IS NULL THEN 0 ELSE 1 END AS nullable,
       null_when,
       meaning
FROM view_column;
