-- Triggers. Columns of other tables are qualified. PostgreSQL runs the same statements in a function.

CREATE TRIGGER run_changes_history AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' OR NEW.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id IN (OLD.robot_id, NEW.robot_id);
END;

CREATE TRIGGER run_leaves_history AFTER DELETE ON run
WHEN OLD.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

CREATE TRIGGER quarantined_production_changes_history AFTER UPDATE OF status ON run
WHEN NEW.kind = 'production' AND NEW.status = 'quarantined' AND OLD.status = 'streaming'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
END;

CREATE TRIGGER run_friction_is_looked_at_again AFTER UPDATE OF status ON run
WHEN NEW.status <> OLD.status
BEGIN
    DELETE FROM run_friction WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER maintenance_changes_history AFTER INSERT ON maintenance
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
END;

CREATE TRIGGER maintenance_taken_back_changes_history AFTER DELETE ON maintenance
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

CREATE TRIGGER open_run_changes_history AFTER UPDATE OF status ON run
WHEN OLD.status = 'streaming' AND NEW.status NOT IN ('streaming', 'complete')
     AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id)
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

CREATE TRIGGER open_run_leaves_history BEFORE DELETE ON run
WHEN OLD.status <> 'complete' AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id)
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;

CREATE TRIGGER run_opens_again AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' AND NEW.status = 'streaming'
BEGIN
    DELETE FROM warmup_fit WHERE run_id = OLD.run_id;
    DELETE FROM parameter_statistic WHERE run_id = OLD.run_id;
    DELETE FROM run_joint_summary WHERE run_id = OLD.run_id;
    DELETE FROM run_friction_index WHERE run_id = OLD.run_id;
    DELETE FROM production_summary WHERE run_id = OLD.run_id;
    DELETE FROM friction_speed_fit
    WHERE cycle_id IN (SELECT cycle.cycle_id FROM cycle WHERE cycle.run_id = OLD.run_id);
    DELETE FROM cycle_friction_level
    WHERE cycle_id IN (SELECT cycle.cycle_id FROM cycle WHERE cycle.run_id = OLD.run_id);
END;

CREATE TRIGGER joined_window_goes AFTER DELETE ON cycle
WHEN OLD.factors_gone = 'joined'
BEGIN
    DELETE FROM log_factor WHERE run_id = OLD.run_id;
    UPDATE cycle SET factors_gone = 'removed' WHERE run_id = OLD.run_id AND factors_gone = 'joined';
END;

CREATE TRIGGER test_leaves_checks AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' AND NEW.status <> 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM production_check
    WHERE reference_run_id = OLD.run_id
          AND cycle_id IN (SELECT cycle_factor_layout.cycle_id FROM cycle_factor_layout);
    DELETE FROM production_summary
    WHERE reference_run_id = OLD.run_id
          AND run_id IN (SELECT cycle.run_id FROM cycle JOIN cycle_factor_layout USING (cycle_id)
                         WHERE cycle.run_id = production_summary.run_id);
END;

CREATE TRIGGER run_series_goes_with_status AFTER UPDATE OF status ON run
WHEN NEW.status <> OLD.status
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_series_goes_with_new_cycle AFTER INSERT ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_series_goes_with_cycle AFTER DELETE ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;

CREATE TRIGGER run_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;

CREATE TRIGGER run_series_goes_with_new_rmsd AFTER INSERT ON torque_rmsd
WHEN NEW.stage = 'all' AND NEW.verification = 'self'
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;

CREATE TRIGGER run_series_goes_with_changed_rmsd AFTER UPDATE ON torque_rmsd
WHEN 'all' IN (OLD.stage, NEW.stage)
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;

CREATE TRIGGER run_series_goes_with_rmsd AFTER DELETE ON torque_rmsd
WHEN OLD.stage = 'all' AND OLD.verification = 'self'
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;

CREATE TRIGGER run_series_goes_with_new_level AFTER INSERT ON cycle_friction_level
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;

CREATE TRIGGER run_series_goes_with_changed_level AFTER UPDATE ON cycle_friction_level
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;

CREATE TRIGGER run_series_goes_with_level AFTER DELETE ON cycle_friction_level
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;

CREATE TRIGGER run_series_goes_with_new_parameter AFTER INSERT ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_series_goes_with_changed_parameter AFTER UPDATE ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;

CREATE TRIGGER run_series_goes_with_parameter AFTER DELETE ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;

CREATE TRIGGER run_series_goes_with_new_summary AFTER INSERT ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_series_goes_with_changed_summary AFTER UPDATE ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;

CREATE TRIGGER run_series_goes_with_summary AFTER DELETE ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;

CREATE TRIGGER run_series_goes_with_new_index AFTER INSERT ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_series_goes_with_changed_index AFTER UPDATE ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;

CREATE TRIGGER run_series_goes_with_index AFTER DELETE ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;

CREATE TRIGGER run_friction_series_goes_with_run AFTER UPDATE OF status, robot_id ON run
WHEN NEW.status <> OLD.status OR NEW.robot_id <> OLD.robot_id
BEGIN
    DELETE FROM run_friction_series WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_friction_series_goes_with_cycle AFTER DELETE ON cycle
BEGIN
    DELETE FROM run_friction_series WHERE run_id = OLD.run_id;
END;

CREATE TRIGGER run_friction_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
BEGIN
    DELETE FROM run_friction_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;

CREATE TRIGGER run_friction_series_goes_with_new_point AFTER INSERT ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;

CREATE TRIGGER run_friction_series_goes_with_changed_point AFTER UPDATE ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;

CREATE TRIGGER run_friction_series_goes_with_point AFTER DELETE ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;

CREATE TRIGGER run_friction_series_goes_with_new_refusal AFTER INSERT ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;

CREATE TRIGGER run_friction_series_goes_with_changed_refusal AFTER UPDATE OF cycle_id ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;

CREATE TRIGGER run_friction_series_goes_with_refusal AFTER DELETE ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;

CREATE TRIGGER check_takes_evidence AFTER DELETE ON production_check
BEGIN
    DELETE FROM window_evidence WHERE cycle_id = OLD.cycle_id;
END;

CREATE TRIGGER summary_takes_evidence AFTER DELETE ON production_summary
BEGIN
    DELETE FROM log_evidence WHERE run_id = OLD.run_id AND reference_run_id = OLD.reference_run_id;
END;

CREATE TRIGGER run_brief_goes_with_series AFTER DELETE ON run_series
BEGIN
    DELETE FROM run_brief WHERE run_id = OLD.run_id;
END;

CREATE TRIGGER settled_history_goes_with_new_test AFTER INSERT ON run
WHEN NEW.status = 'complete' AND NEW.kind = 'test'
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;

CREATE TRIGGER settled_history_goes_with_changed_test
AFTER UPDATE OF robot_id, kind, status, started_at, cycles_stored, robot_model_id, figures_hash ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;

CREATE TRIGGER settled_history_goes_with_test AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;

CREATE TRIGGER settled_history_goes_with_brief AFTER DELETE ON run_brief
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;

CREATE TRIGGER settled_history_goes_with_changed_reason AFTER UPDATE OF reason ON cycle
WHEN 'refused' IN (OLD.status, NEW.status)
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;

CREATE TRIGGER settled_history_goes_with_new_refusal AFTER INSERT ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id)
                                WHERE cycle.cycle_id = NEW.cycle_id);
END;

CREATE TRIGGER settled_history_goes_with_changed_refusal AFTER UPDATE ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id)
                                WHERE cycle.cycle_id = OLD.cycle_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id)
                                WHERE cycle.cycle_id = NEW.cycle_id);
END;

CREATE TRIGGER settled_history_goes_with_refusal AFTER DELETE ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id)
                                WHERE cycle.cycle_id = OLD.cycle_id);
END;

CREATE TRIGGER settled_history_goes_with_new_response AFTER INSERT ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;

CREATE TRIGGER settled_history_goes_with_changed_response AFTER UPDATE ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;

CREATE TRIGGER settled_history_goes_with_response AFTER DELETE ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;

CREATE TRIGGER settled_history_goes_with_new_work AFTER INSERT ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;

CREATE TRIGGER settled_history_goes_with_changed_work AFTER UPDATE ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;

CREATE TRIGGER settled_history_goes_with_work AFTER DELETE ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
END;

CREATE TRIGGER friction_plan_goes_with_new_test AFTER INSERT ON run
WHEN NEW.status = 'complete' AND NEW.kind = 'test'
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;

CREATE TRIGGER friction_plan_goes_with_changed_test
AFTER UPDATE OF robot_id, kind, status, started_at, robot_model_id, figures_hash ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;

CREATE TRIGGER friction_plan_goes_with_test AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;

CREATE TRIGGER friction_plan_goes_with_friction AFTER DELETE ON run_friction
BEGIN
    DELETE FROM friction_plan
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;

CREATE TRIGGER friction_plan_goes_with_new_work AFTER INSERT ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;

CREATE TRIGGER friction_plan_goes_with_changed_work AFTER UPDATE ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;

CREATE TRIGGER friction_plan_goes_with_work AFTER DELETE ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
END;

CREATE TRIGGER settled_history_goes_with_new_log AFTER INSERT ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;

CREATE TRIGGER settled_history_goes_with_changed_log AFTER UPDATE ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;

CREATE TRIGGER settled_history_goes_with_log AFTER DELETE ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;

CREATE TRIGGER settled_history_goes_with_changed_work_run AFTER UPDATE OF robot_id, kind, status, started_at ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'production' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;

CREATE TRIGGER settled_history_goes_with_work_run AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'production'
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;

CREATE TRIGGER settled_history_goes_with_error_of_test AFTER UPDATE OF relative_rmsd ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
END;

CREATE TRIGGER settled_history_goes_with_test_without_error AFTER DELETE ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = OLD.run_id);
END;

CREATE TRIGGER settled_history_goes_with_test_with_error AFTER INSERT ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
END;
