-- Exports that go on where their end was.

-- 1: the end of the file has cut this cycle. Where the file goes on behind that end, the cycle has more rows than these.
ALTER TABLE cycle ADD COLUMN cut_by_end INTEGER NOT NULL DEFAULT 0 CHECK (cut_by_end IN (0, 1));

-- A complete run that is opened again says nothing as a whole until it ends again; it may end in quarantine.
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

-- What runs that were refused after they had been opened again still say as a whole.
DELETE FROM warmup_fit
WHERE run_id IN (SELECT run.run_id FROM run WHERE run.status = 'quarantined' AND run.superseded_by_run_id IS NULL);
DELETE FROM parameter_statistic
WHERE run_id IN (SELECT run.run_id FROM run WHERE run.status = 'quarantined' AND run.superseded_by_run_id IS NULL);
DELETE FROM run_joint_summary
WHERE run_id IN (SELECT run.run_id FROM run WHERE run.status = 'quarantined' AND run.superseded_by_run_id IS NULL);
DELETE FROM run_friction_index
WHERE run_id IN (SELECT run.run_id FROM run WHERE run.status = 'quarantined' AND run.superseded_by_run_id IS NULL);
DELETE FROM friction_speed_fit
WHERE cycle_id IN (
    SELECT cycle.cycle_id FROM cycle JOIN run USING (run_id)
    WHERE run.status = 'quarantined' AND run.superseded_by_run_id IS NULL
);
DELETE FROM cycle_friction_level
WHERE cycle_id IN (
    SELECT cycle.cycle_id FROM cycle JOIN run USING (run_id)
    WHERE run.status = 'quarantined' AND run.superseded_by_run_id IS NULL
);
