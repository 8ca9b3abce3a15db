-- Triggers, as SQLite has them: each with the function of its name.

CREATE FUNCTION run_changes_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id IN (OLD.robot_id, NEW.robot_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_changes_history AFTER UPDATE OF status ON run
FOR EACH ROW
WHEN (OLD.status = 'complete' OR NEW.status = 'complete')
EXECUTE FUNCTION run_changes_history();

CREATE FUNCTION run_leaves_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_leaves_history AFTER DELETE ON run
FOR EACH ROW
WHEN (OLD.status = 'complete')
EXECUTE FUNCTION run_leaves_history();

CREATE FUNCTION quarantined_production_changes_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
    RETURN NULL;
END $$;
CREATE TRIGGER quarantined_production_changes_history AFTER UPDATE OF status ON run
FOR EACH ROW
WHEN (NEW.kind = 'production' AND NEW.status = 'quarantined' AND OLD.status = 'streaming')
EXECUTE FUNCTION quarantined_production_changes_history();

CREATE FUNCTION run_friction_is_looked_at_again() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_is_looked_at_again AFTER UPDATE OF status ON run
FOR EACH ROW
WHEN (NEW.status <> OLD.status)
EXECUTE FUNCTION run_friction_is_looked_at_again();

CREATE FUNCTION maintenance_changes_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
    RETURN NULL;
END $$;
CREATE TRIGGER maintenance_changes_history AFTER INSERT ON maintenance
FOR EACH ROW
EXECUTE FUNCTION maintenance_changes_history();

CREATE FUNCTION maintenance_taken_back_changes_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
    RETURN NULL;
END $$;
CREATE TRIGGER maintenance_taken_back_changes_history AFTER DELETE ON maintenance
FOR EACH ROW
EXECUTE FUNCTION maintenance_taken_back_changes_history();

CREATE FUNCTION open_run_changes_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF OLD.status = 'streaming' AND NEW.status NOT IN ('streaming', 'complete')
        AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id) THEN
        UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
    END IF;
    RETURN NULL;
END $$;
CREATE TRIGGER open_run_changes_history AFTER UPDATE OF status ON run
FOR EACH ROW
EXECUTE FUNCTION open_run_changes_history();

CREATE FUNCTION open_run_leaves_history() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF OLD.status <> 'complete' AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id) THEN
        UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
    END IF;
    RETURN OLD;
END $$;
CREATE TRIGGER open_run_leaves_history BEFORE DELETE ON run
FOR EACH ROW
EXECUTE FUNCTION open_run_leaves_history();

CREATE FUNCTION run_opens_again() RETURNS trigger LANGUAGE plpgsql AS $$
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
    RETURN NULL;
END $$;
CREATE TRIGGER run_opens_again AFTER UPDATE OF status ON run
FOR EACH ROW
WHEN (OLD.status = 'complete' AND NEW.status = 'streaming')
EXECUTE FUNCTION run_opens_again();

CREATE FUNCTION joined_window_goes() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM log_factor WHERE run_id = OLD.run_id;
    UPDATE cycle SET factors_gone = 'removed' WHERE run_id = OLD.run_id AND factors_gone = 'joined';
    RETURN NULL;
END $$;
CREATE TRIGGER joined_window_goes AFTER DELETE ON cycle
FOR EACH ROW
WHEN (OLD.factors_gone = 'joined')
EXECUTE FUNCTION joined_window_goes();

CREATE FUNCTION test_leaves_checks() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM production_check
    WHERE reference_run_id = OLD.run_id
          AND cycle_id IN (SELECT cycle_factor_layout.cycle_id FROM cycle_factor_layout);
    DELETE FROM production_summary
    WHERE reference_run_id = OLD.run_id
          AND run_id IN (SELECT cycle.run_id FROM cycle JOIN cycle_factor_layout USING (cycle_id)
                         WHERE cycle.run_id = production_summary.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER test_leaves_checks AFTER UPDATE OF status ON run
FOR EACH ROW
WHEN (OLD.status = 'complete' AND NEW.status <> 'complete' AND OLD.kind = 'test')
EXECUTE FUNCTION test_leaves_checks();

CREATE FUNCTION run_series_goes_with_status() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_status AFTER UPDATE OF status ON run
FOR EACH ROW
WHEN (NEW.status <> OLD.status)
EXECUTE FUNCTION run_series_goes_with_status();

CREATE FUNCTION run_series_goes_with_new_cycle() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_new_cycle AFTER INSERT ON cycle
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_new_cycle();

CREATE FUNCTION run_series_goes_with_cycle() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_cycle AFTER DELETE ON cycle
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_cycle();

CREATE FUNCTION run_series_goes_with_changed_cycle() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_changed_cycle();

CREATE FUNCTION run_series_goes_with_new_rmsd() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_new_rmsd AFTER INSERT ON torque_rmsd
FOR EACH ROW
WHEN (NEW.stage = 'all' AND NEW.verification = 'self')
EXECUTE FUNCTION run_series_goes_with_new_rmsd();

CREATE FUNCTION run_series_goes_with_changed_rmsd() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_changed_rmsd AFTER UPDATE ON torque_rmsd
FOR EACH ROW
WHEN ('all' IN (OLD.stage, NEW.stage))
EXECUTE FUNCTION run_series_goes_with_changed_rmsd();

CREATE FUNCTION run_series_goes_with_rmsd() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_rmsd AFTER DELETE ON torque_rmsd
FOR EACH ROW
WHEN (OLD.stage = 'all' AND OLD.verification = 'self')
EXECUTE FUNCTION run_series_goes_with_rmsd();

CREATE FUNCTION run_series_goes_with_new_level() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_new_level AFTER INSERT ON cycle_friction_level
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_new_level();

CREATE FUNCTION run_series_goes_with_changed_level() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_changed_level AFTER UPDATE ON cycle_friction_level
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_changed_level();

CREATE FUNCTION run_series_goes_with_level() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_level AFTER DELETE ON cycle_friction_level
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_level();

CREATE FUNCTION run_series_goes_with_new_parameter() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_new_parameter AFTER INSERT ON parameter_statistic
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_new_parameter();

CREATE FUNCTION run_series_goes_with_changed_parameter() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_changed_parameter AFTER UPDATE ON parameter_statistic
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_changed_parameter();

CREATE FUNCTION run_series_goes_with_parameter() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_parameter AFTER DELETE ON parameter_statistic
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_parameter();

CREATE FUNCTION run_series_goes_with_new_summary() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_new_summary AFTER INSERT ON run_joint_summary
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_new_summary();

CREATE FUNCTION run_series_goes_with_changed_summary() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_changed_summary AFTER UPDATE ON run_joint_summary
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_changed_summary();

CREATE FUNCTION run_series_goes_with_summary() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_summary AFTER DELETE ON run_joint_summary
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_summary();

CREATE FUNCTION run_series_goes_with_new_index() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_new_index AFTER INSERT ON run_friction_index
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_new_index();

CREATE FUNCTION run_series_goes_with_changed_index() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_changed_index AFTER UPDATE ON run_friction_index
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_changed_index();

CREATE FUNCTION run_series_goes_with_index() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_series_goes_with_index AFTER DELETE ON run_friction_index
FOR EACH ROW
EXECUTE FUNCTION run_series_goes_with_index();

CREATE FUNCTION run_friction_series_goes_with_run() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series WHERE run_id = NEW.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_run AFTER UPDATE OF status, robot_id ON run
FOR EACH ROW
WHEN (NEW.status <> OLD.status OR NEW.robot_id IS DISTINCT FROM OLD.robot_id)
EXECUTE FUNCTION run_friction_series_goes_with_run();

CREATE FUNCTION run_friction_series_goes_with_cycle() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series WHERE run_id = OLD.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_cycle AFTER DELETE ON cycle
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_cycle();

CREATE FUNCTION run_friction_series_goes_with_changed_cycle() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series WHERE run_id IN (OLD.run_id, NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_changed_cycle();

CREATE FUNCTION run_friction_series_goes_with_new_point() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_new_point AFTER INSERT ON friction_point
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_new_point();

CREATE FUNCTION run_friction_series_goes_with_changed_point() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_changed_point AFTER UPDATE ON friction_point
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_changed_point();

CREATE FUNCTION run_friction_series_goes_with_point() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_point AFTER DELETE ON friction_point
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_point();

CREATE FUNCTION run_friction_series_goes_with_new_refusal() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_new_refusal AFTER INSERT ON cycle_refusal
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_new_refusal();

CREATE FUNCTION run_friction_series_goes_with_changed_refusal() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_changed_refusal AFTER UPDATE OF cycle_id ON cycle_refusal
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_changed_refusal();

CREATE FUNCTION run_friction_series_goes_with_refusal() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER run_friction_series_goes_with_refusal AFTER DELETE ON cycle_refusal
FOR EACH ROW
EXECUTE FUNCTION run_friction_series_goes_with_refusal();

CREATE FUNCTION check_takes_evidence() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM window_evidence WHERE cycle_id = OLD.cycle_id;
    RETURN NULL;
END $$;
CREATE TRIGGER check_takes_evidence AFTER DELETE ON production_check
FOR EACH ROW
EXECUTE FUNCTION check_takes_evidence();

CREATE FUNCTION summary_takes_evidence() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM log_evidence WHERE run_id = OLD.run_id AND reference_run_id = OLD.reference_run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER summary_takes_evidence AFTER DELETE ON production_summary
FOR EACH ROW
EXECUTE FUNCTION summary_takes_evidence();

CREATE FUNCTION run_brief_goes_with_series() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM run_brief WHERE run_id = OLD.run_id;
    RETURN NULL;
END $$;
CREATE TRIGGER run_brief_goes_with_series AFTER DELETE ON run_series
FOR EACH ROW
EXECUTE FUNCTION run_brief_goes_with_series();

CREATE FUNCTION settled_history_goes_with_new_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_new_test AFTER INSERT ON run
FOR EACH ROW
WHEN (NEW.status = 'complete' AND NEW.kind = 'test')
EXECUTE FUNCTION settled_history_goes_with_new_test();

CREATE FUNCTION settled_history_goes_with_changed_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_test AFTER UPDATE OF robot_id, kind, status, started_at, cycles_stored, robot_model_id, figures_hash ON run
FOR EACH ROW
WHEN ('complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind))
EXECUTE FUNCTION settled_history_goes_with_changed_test();

CREATE FUNCTION settled_history_goes_with_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_test AFTER DELETE ON run
FOR EACH ROW
WHEN (OLD.status = 'complete' AND OLD.kind = 'test')
EXECUTE FUNCTION settled_history_goes_with_test();

CREATE FUNCTION settled_history_goes_with_brief() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_brief AFTER DELETE ON run_brief
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_brief();

CREATE FUNCTION settled_history_goes_with_changed_reason() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_reason AFTER UPDATE OF reason ON cycle
FOR EACH ROW
WHEN ('refused' IN (OLD.status, NEW.status))
EXECUTE FUNCTION settled_history_goes_with_changed_reason();

CREATE FUNCTION settled_history_goes_with_new_refusal() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_new_refusal AFTER INSERT ON cycle_refusal
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_new_refusal();

CREATE FUNCTION settled_history_goes_with_changed_refusal() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_refusal AFTER UPDATE ON cycle_refusal
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_changed_refusal();

CREATE FUNCTION settled_history_goes_with_refusal() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_refusal AFTER DELETE ON cycle_refusal
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_refusal();

CREATE FUNCTION settled_history_goes_with_new_response() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_new_response AFTER INSERT ON channel_response
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_new_response();

CREATE FUNCTION settled_history_goes_with_changed_response() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_response AFTER UPDATE ON channel_response
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_changed_response();

CREATE FUNCTION settled_history_goes_with_response() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_response AFTER DELETE ON channel_response
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_response();

CREATE FUNCTION settled_history_goes_with_new_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_new_work AFTER INSERT ON maintenance
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_new_work();

CREATE FUNCTION settled_history_goes_with_changed_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_work AFTER UPDATE ON maintenance
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_changed_work();

CREATE FUNCTION settled_history_goes_with_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_work AFTER DELETE ON maintenance
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_work();

-- A log of ordinary work changes as what it comes to does, or as its run does.
CREATE FUNCTION settled_history_goes_with_new_log() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_new_log AFTER INSERT ON production_summary
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_new_log();

CREATE FUNCTION settled_history_goes_with_changed_log() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_log AFTER UPDATE ON production_summary
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_changed_log();

CREATE FUNCTION settled_history_goes_with_log() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_log AFTER DELETE ON production_summary
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_log();

CREATE FUNCTION settled_history_goes_with_changed_work_run() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_changed_work_run AFTER UPDATE OF robot_id, kind, status, started_at ON run
FOR EACH ROW
WHEN ('complete' IN (OLD.status, NEW.status) AND 'production' IN (OLD.kind, NEW.kind))
EXECUTE FUNCTION settled_history_goes_with_changed_work_run();

CREATE FUNCTION settled_history_goes_with_work_run() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_work_run AFTER DELETE ON run
FOR EACH ROW
WHEN (OLD.status = 'complete' AND OLD.kind = 'production')
EXECUTE FUNCTION settled_history_goes_with_work_run();

-- What a test leaves of its own torque is a limit of the logs that are held against it.
CREATE FUNCTION settled_history_goes_with_error_of_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_error_of_test AFTER UPDATE OF relative_rmsd ON run_joint_summary
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_error_of_test();

CREATE FUNCTION settled_history_goes_with_test_without_error() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = OLD.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_test_without_error AFTER DELETE ON run_joint_summary
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_test_without_error();

CREATE FUNCTION settled_history_goes_with_test_with_error() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER settled_history_goes_with_test_with_error AFTER INSERT ON run_joint_summary
FOR EACH ROW
EXECUTE FUNCTION settled_history_goes_with_test_with_error();

CREATE FUNCTION friction_plan_goes_with_new_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_new_test AFTER INSERT ON run
FOR EACH ROW
WHEN (NEW.status = 'complete' AND NEW.kind = 'test')
EXECUTE FUNCTION friction_plan_goes_with_new_test();

CREATE FUNCTION friction_plan_goes_with_changed_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_changed_test AFTER UPDATE OF robot_id, kind, status, started_at, robot_model_id, figures_hash ON run
FOR EACH ROW
WHEN ('complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind))
EXECUTE FUNCTION friction_plan_goes_with_changed_test();

CREATE FUNCTION friction_plan_goes_with_test() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_test AFTER DELETE ON run
FOR EACH ROW
WHEN (OLD.status = 'complete' AND OLD.kind = 'test')
EXECUTE FUNCTION friction_plan_goes_with_test();

CREATE FUNCTION friction_plan_goes_with_friction() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_friction AFTER DELETE ON run_friction
FOR EACH ROW
EXECUTE FUNCTION friction_plan_goes_with_friction();

CREATE FUNCTION friction_plan_goes_with_new_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_new_work AFTER INSERT ON maintenance
FOR EACH ROW
EXECUTE FUNCTION friction_plan_goes_with_new_work();

CREATE FUNCTION friction_plan_goes_with_changed_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_changed_work AFTER UPDATE ON maintenance
FOR EACH ROW
EXECUTE FUNCTION friction_plan_goes_with_changed_work();

CREATE FUNCTION friction_plan_goes_with_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    RETURN NULL;
END $$;
CREATE TRIGGER friction_plan_goes_with_work AFTER DELETE ON maintenance
FOR EACH ROW
EXECUTE FUNCTION friction_plan_goes_with_work();
