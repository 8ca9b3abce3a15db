-- Friction of each joint in each cycle as one number, which the detectors compare over cycles and runs.

-- Written when conclusions are drawn, from the friction points of the cycle.
CREATE TABLE cycle_friction_level (
    cycle_id       INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint          INTEGER NOT NULL CHECK (joint >= 1),
    -- Mean time of the points since the start of the recording.
    minute         REAL NOT NULL,
    -- Mean over the levels of the natural logarithm of half the difference between both directions.
    ln_torque      REAL NOT NULL,
    -- Mean over the levels of half the sum of both directions.
    offset_nm      REAL NOT NULL,
    levels         INTEGER NOT NULL CHECK (levels >= 1),
    -- Mean over the levels.
    speed_fraction REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

-- The contract -------------------------------------------------------------------------------------

CREATE VIEW cycle_friction AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       level.joint,
       level.minute,
       level.ln_torque,
       level.offset_nm,
       level.levels,
       level.speed_fraction
FROM cycle_friction_level AS level
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
