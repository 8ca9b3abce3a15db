-- A doubtful cycle has all its numbers, and nothing is concluded from them: an accepted finding, or one that leaves a
-- doubt, stands in its remarks. A column of its own, since the check of the status cannot be changed in place.

ALTER TABLE cycle ADD COLUMN doubtful INTEGER NOT NULL DEFAULT 0 CHECK (doubtful IN (0, 1));

DROP VIEW cycles;

CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch') AS started_at,
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
