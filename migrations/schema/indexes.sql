-- Indexes, in the order of the tables. An index that is changed gets another name.

CREATE INDEX host_session_alive ON host_session (alive_until) WHERE ended_at IS NULL;
CREATE INDEX host_session_by_host ON host_session (host, host_session_id);
CREATE INDEX claim_by_session ON claim (host_session_id);
CREATE INDEX run_by_robot ON run (robot_id, status, started_at, run_id);
CREATE INDEX run_by_replaced ON run (replaces_run_id) WHERE replaces_run_id IS NOT NULL;
CREATE INDEX run_by_successor ON run (superseded_by_run_id) WHERE superseded_by_run_id IS NOT NULL;
CREATE INDEX run_by_file ON run (inode, device) WHERE inode IS NOT NULL;
CREATE INDEX run_by_retry ON run (retry_asked_at) WHERE retry_asked_at IS NOT NULL;
CREATE INDEX run_by_name ON run (source_name);
CREATE INDEX run_complete_test ON run (robot_id, started_at, run_id) WHERE kind = 'test' AND status = 'complete';
CREATE INDEX run_unfinished ON run (run_id) WHERE status = 'streaming';
CREATE INDEX run_by_start_text ON run (started_at_text);
CREATE INDEX run_by_session ON run (host_session_id) WHERE host_session_id IS NOT NULL;
CREATE INDEX run_by_bytes ON run (source_bytes);
CREATE INDEX run_production ON run (robot_id, status, started_at, run_id) WHERE kind = 'production';
CREATE INDEX run_of_robot_by_start_text
ON run (robot_id, started_at_text, run_id, status, superseded_by_run_id, kind, model);
CREATE INDEX run_set_aside ON run (robot_id, run_id) WHERE set_aside IS NOT NULL;
CREATE INDEX source_file_by_run ON source_file (run_id);
CREATE INDEX fault_by_run ON fault (run_id, fault_id);
CREATE INDEX dismissal_by_fault ON dismissal (fault_id);
CREATE UNIQUE INDEX dismissal_in_force ON dismissal (fault_id) WHERE withdrawn_at IS NULL;
CREATE INDEX blocked_file_by_run ON blocked_file (run_id);
CREATE INDEX blocked_file_by_robot ON blocked_file (robot);
CREATE INDEX cycle_with_kept_estimate ON cycle (estimator_wanted) WHERE estimator_wanted IS NOT NULL;
CREATE INDEX cycle_refused ON cycle (run_id) WHERE status = 'refused';
CREATE INDEX cycle_with_factors ON cycle (run_id, number) WHERE factors_gone IS NULL AND status = 'complete';
CREATE INDEX cycle_shown_as_refused ON cycle (run_id)
WHERE CASE WHEN doubtful THEN 'doubtful' ELSE status END COLLATE BINARY = 'refused';
CREATE INDEX cycle_with_remarks ON cycle (started_at_text)
WHERE remarks IS NOT NULL OR CASE WHEN doubtful THEN 'doubtful' ELSE status END COLLATE BINARY = 'doubtful';
CREATE INDEX cycle_by_estimator ON cycle (estimator, estimator_wanted, run_id) WHERE samples IS NOT NULL;
CREATE UNIQUE INDEX torque_rmsd_key ON torque_rmsd (cycle_id, stage, joint, coalesce(reference_run_id, 0));
CREATE INDEX torque_rmsd_by_reference ON torque_rmsd (reference_run_id) WHERE reference_run_id IS NOT NULL;
CREATE INDEX cycle_factor_layout_by_layout ON cycle_factor_layout (factor_layout_id);
CREATE INDEX log_factor_by_layout ON log_factor (factor_layout_id);
CREATE UNIQUE INDEX warmup_fit_key ON warmup_fit (robot_id, coalesce(run_id, 0), joint, speed_fraction);
CREATE INDEX warmup_fit_by_run ON warmup_fit (run_id) WHERE run_id IS NOT NULL;
CREATE INDEX production_check_by_reference ON production_check (reference_run_id);
CREATE INDEX production_summary_by_reference ON production_summary (reference_run_id);
CREATE INDEX log_evidence_by_reference ON log_evidence (reference_run_id);
CREATE INDEX parameter_set_by_model ON parameter_set (robot_model_id);
CREATE INDEX reestimate_by_model ON reestimate (robot_model_id);
CREATE INDEX reestimate_value_by_parameter ON reestimate_value (model_parameter_id);
CREATE INDEX reestimate_statistic_by_parameter ON reestimate_statistic (model_parameter_id);
CREATE UNIQUE INDEX friction_baseline_in_force ON friction_baseline (robot_id, joint, epoch) WHERE replaced_at IS NULL;
CREATE INDEX friction_baseline_by_robot ON friction_baseline (robot_id);
CREATE INDEX friction_baseline_by_run ON friction_baseline_run (run_id);
CREATE INDEX run_friction_series_by_robot ON run_friction_series (robot_id);
CREATE INDEX settled_history_by_time ON settled_history (robot_id, follows_until);
CREATE INDEX maintenance_by_robot ON maintenance (robot_id, at);
CREATE INDEX joint_health_by_last_result ON joint_health (last_result_run_id);
CREATE INDEX anomaly_by_robot ON anomaly (robot_id, kind, joint);
CREATE INDEX anomaly_by_first_run ON anomaly (first_run_id);
CREATE INDEX anomaly_by_last_run ON anomaly (last_run_id);
CREATE INDEX anomaly_by_onset_run ON anomaly (onset_run_id);
CREATE INDEX anomaly_by_open_run ON anomaly (open_run_id) WHERE open_run_id IS NOT NULL;
CREATE INDEX anomaly_by_settled_history ON anomaly (settled_history_id) WHERE settled_history_id IS NOT NULL;
CREATE INDEX anomaly_not_settled ON anomaly (robot_id, anomaly_id) WHERE settled_history_id IS NULL;
CREATE INDEX anomaly_by_state ON anomaly (state, robot_id, severity) WHERE NOT withdrawn;
CREATE INDEX anomaly_in_force ON anomaly (robot_id, joint)
WHERE state NOT IN ('resolved', 'false_alarm') AND NOT withdrawn;
CREATE INDEX anomaly_event_by_anomaly ON anomaly_event (anomaly_id);
CREATE INDEX anomaly_event_by_run ON anomaly_event (run_id);
CREATE INDEX delivery_by_event ON delivery (anomaly_event_id);
CREATE INDEX delivery_pending ON delivery (delivery_route_id, due_at) WHERE state = 'pending';
CREATE INDEX delivery_sent ON delivery (delivery_route_id, sent_at) WHERE state = 'sent';
