-- What is kept in the long run: results for ever, factors for as long as they are asked for.

-- What became of the factors of a cycle. 'joined': the log's windows have one together (log_factor); 'removed': their
-- time was over. NULL: they are stored, or there never were any.
ALTER TABLE cycle ADD COLUMN factors_gone TEXT CHECK (factors_gone IN ('joined', 'removed'));

-- Factors of the joined windows of a log of ordinary work: every row of these windows is in exactly one. Columns as in
-- torque_factor.
CREATE TABLE log_factor (
    log_factor_id    INTEGER PRIMARY KEY,
    run_id           INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    factor_layout_id INTEGER NOT NULL REFERENCES factor_layout,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    stage            TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'between')),
    motion           TEXT NOT NULL CHECK (motion IN ('moving', 'slow')),
    rows             INTEGER NOT NULL CHECK (rows >= 1),
    factor           BLOB NOT NULL,
    UNIQUE (run_id, factor_layout_id, stage, motion, joint)
) STRICT;
CREATE INDEX log_factor_by_layout ON log_factor (factor_layout_id);

-- A window cannot be taken out of the factor that it was joined into. Where one goes, because its log is read again or
-- goes on behind it, the others have no factor any more.
CREATE TRIGGER joined_window_goes AFTER DELETE ON cycle
WHEN OLD.factors_gone = 'joined'
BEGIN
    DELETE FROM log_factor WHERE run_id = OLD.run_id;
    UPDATE cycle SET factors_gone = 'removed' WHERE run_id = OLD.run_id AND factors_gone = 'joined';
END;

-- A test that is reopened, superseded or quarantined has no parameters any more, or will have others under the same
-- key: nothing is held against it. Windows without factors keep what was found: it cannot be made again.
DROP TRIGGER test_leaves_checks;
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
