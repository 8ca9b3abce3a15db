-- What production is held against follows from the robot's history, and robots are watched between tests.

-- The mean and the largest deviation of a window were known only of windows that were read after their test; what
-- is stored of a window, from which every check can be made again, does not know them.
DROP VIEW production_checks;

ALTER TABLE production_check DROP COLUMN bias_nm;
ALTER TABLE production_check DROP COLUMN max_nm;
-- Friction of the window beyond the test's, as a fraction of it, and the part of the squared deviation that this
-- explains; NULL where the joint does not move.
ALTER TABLE production_check ADD COLUMN friction_excess REAL;
ALTER TABLE production_check ADD COLUMN friction_share REAL;
-- 1: conclusions have settled which test it is. 0: as it was when the window was read.
ALTER TABLE production_check ADD COLUMN settled INTEGER NOT NULL DEFAULT 0 CHECK (settled IN (0, 1));

-- Medians over the windows of a run that are held against one test and in which the joint moves.
CREATE TABLE production_summary (
    run_id           INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    windows          INTEGER NOT NULL CHECK (windows >= 1),
    relative_rmsd    REAL NOT NULL,
    friction_excess  REAL NOT NULL,
    friction_share   REAL NOT NULL,
    PRIMARY KEY (run_id, reference_run_id, joint)
) STRICT, WITHOUT ROWID;
-- Deleting a run looks for what refers to it.
CREATE INDEX production_summary_by_reference ON production_summary (reference_run_id);

-- A test that is reopened, superseded or quarantined has no parameters any more, or will have others under the same
-- key: nothing is held against it.
CREATE TRIGGER test_leaves_checks AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' AND NEW.status <> 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM production_check WHERE reference_run_id = OLD.run_id;
    DELETE FROM production_summary WHERE reference_run_id = OLD.run_id;
END;

-- Windows of a quarantined log stay visible, so their checks are to be settled too.
CREATE TRIGGER quarantined_production_changes_history AFTER UPDATE OF status ON run
WHEN NEW.kind = 'production' AND NEW.status = 'quarantined' AND OLD.status = 'streaming'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
END;

-- Checks that were made before are settled with the next conclusions.
UPDATE robot SET history = history + 1
WHERE EXISTS (SELECT 1 FROM run WHERE run.robot_id = robot.robot_id AND run.kind = 'production');

-- The contract -------------------------------------------------------------------------------------

CREATE VIEW production_checks AS
SELECT run.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
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
       CASE WHEN production_check.joint IS NULL THEN ifnull(cycle.reason, 'no model yet') END AS reason
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;

CREATE VIEW production_trend AS
SELECT robot.name AS robot,
       run.run_id,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
       production_summary.joint,
       production_summary.reference_run_id,
       production_summary.windows,
       production_summary.relative_rmsd AS moving_relative_rmsd,
       production_summary.friction_excess,
       production_summary.friction_share
FROM production_summary
JOIN run USING (run_id)
JOIN robot USING (robot_id)
WHERE run.superseded_by_run_id IS NULL;
