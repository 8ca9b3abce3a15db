-- Ordinary work is judged by the same hypotheses as tests.

-- What a window leaves of the torque that its test leads to expect, along what each cause would change
-- (store::results::production_evidence has the format). It goes with the window's factors, since what its log comes to is
-- kept below.
CREATE TABLE window_evidence (
    cycle_id INTEGER PRIMARY KEY REFERENCES cycle ON DELETE CASCADE,
    numbers  BLOB NOT NULL
) STRICT;

-- The same of the windows of a log that are held against one test, in the same format.
CREATE TABLE log_evidence (
    run_id           INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    numbers          BLOB NOT NULL,
    PRIMARY KEY (run_id, reference_run_id)
) STRICT, WITHOUT ROWID;
-- Deleting a run looks for what refers to it.
CREATE INDEX log_evidence_by_reference ON log_evidence (reference_run_id);

-- What was found against a test goes with the check, and what a log comes to with its summary.
CREATE TRIGGER check_takes_evidence AFTER DELETE ON production_check
BEGIN
    DELETE FROM window_evidence WHERE cycle_id = OLD.cycle_id;
END;
CREATE TRIGGER summary_takes_evidence AFTER DELETE ON production_summary
BEGIN
    DELETE FROM log_evidence WHERE run_id = OLD.run_id AND reference_run_id = OLD.reference_run_id;
END;
