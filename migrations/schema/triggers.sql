-- Triggers. Columns of other tables are qualified. PostgreSQL runs the same statements in a function.

-- A complete test that becomes the latest changes no earlier one.
CREATE TRIGGER run_changes_history
AFTER UPDATE OF status, started_at, robot_id, kind, robot_model_id, figures_hash ON run
WHEN OLD.status = 'complete' OR NEW.status = 'complete'
BEGIN
    UPDATE robot
    SET history = history + 1,
        past_revision = past_revision
            + CASE WHEN 'test' IN (OLD.kind, NEW.kind)
                        AND (OLD.status = 'complete'
                             OR EXISTS (SELECT 1 FROM run AS later
                                        WHERE later.robot_id = NEW.robot_id AND later.kind = 'test'
                                              AND later.status = 'complete'
                                              AND (later.started_at, later.run_id) > (NEW.started_at, NEW.run_id)))
                   THEN 1 ELSE 0 END
    WHERE robot_id IN (OLD.robot_id, NEW.robot_id);
END;

CREATE TRIGGER run_leaves_history AFTER DELETE ON run
WHEN OLD.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1, past_revision = past_revision + 1 WHERE robot_id = OLD.robot_id;
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
    UPDATE robot SET history = history + 1, past_revision = past_revision + 1 WHERE robot_id = NEW.robot_id;
END;

CREATE TRIGGER maintenance_taken_back_changes_history AFTER DELETE ON maintenance
BEGIN
    UPDATE robot SET history = history + 1, past_revision = past_revision + 1 WHERE robot_id = OLD.robot_id;
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

CREATE TRIGGER check_takes_evidence AFTER DELETE ON production_check
BEGIN
    DELETE FROM window_evidence WHERE cycle_id = OLD.cycle_id;
END;

CREATE TRIGGER summary_takes_evidence AFTER DELETE ON production_summary
BEGIN
    DELETE FROM log_evidence WHERE run_id = OLD.run_id AND reference_run_id = OLD.reference_run_id;
END;

-- The revision of a run counts changes of the figures that kept values follow from. Rows of a cycle change only together with the
-- cycle, and cycles are added or deleted only together with their number in the run.

CREATE TRIGGER run_counts_revision AFTER UPDATE OF status, cycles_stored ON run
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER cycle_counts_revision AFTER UPDATE OF number, status, doubtful, estimator ON cycle
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_joint_summary_counts_revision AFTER UPDATE ON run_joint_summary
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER parameter_statistic_counts_revision AFTER INSERT ON parameter_statistic
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;

CREATE TRIGGER run_friction_counts_revision AFTER INSERT ON run_friction
BEGIN
    UPDATE run SET revision = revision + 1 WHERE run_id = NEW.run_id;
END;
