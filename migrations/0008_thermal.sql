-- What warms a joint, and what the friction index is beside warm-up: friction as measured, runs too short for the map.

-- Mean magnitude of each joint's velocity over the cycle, rad/s, as a JSON array from the first joint on: how much of
-- a test's heat the cycle makes. NULL in cycles stored before, and where the channels were refused.
ALTER TABLE cycle ADD COLUMN mean_speeds_rad_s TEXT
    CHECK (mean_speeds_rad_s IS NULL OR json_valid(mean_speeds_rad_s));

-- Friction of the run as measured against that of the baseline; NULL without a common level, or in rows made before.
ALTER TABLE run_friction_index ADD COLUMN raw_index REAL;
-- 1: the run has too few cycles for the map, its thermal state stands on the map alone.
ALTER TABLE run_friction_index ADD COLUMN short_run INTEGER NOT NULL DEFAULT 0 CHECK (short_run IN (0, 1));

-- The contract -------------------------------------------------------------------------------------

DROP VIEW friction_index;

CREATE VIEW friction_index AS
SELECT robot.name AS robot,
       found.run_id,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
       found.joint,
       found.friction_index,
       found.friction_index_std_error,
       found.ambient_coldness,
       found.ambient_coldness_std_error,
       found.coldness_at_start,
       found.points,
       found.raw_index,
       found.short_run
FROM run_friction_index AS found
JOIN run USING (run_id)
JOIN robot USING (robot_id);
