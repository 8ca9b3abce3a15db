-- Noise of the torque channels: what tells a torque signal with more noise from a gear with play.

-- Of the excitation stage of cycles with parameters. Cycles stored before have none.
CREATE TABLE channel_noise (
    cycle_id       INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint          INTEGER NOT NULL CHECK (joint >= 1),
    noise_nm       REAL NOT NULL,
    relative_noise REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

-- Median over the cycles of a test.
ALTER TABLE run_joint_summary ADD COLUMN relative_noise REAL;

CREATE VIEW torque_noise AS
SELECT robot.name   AS robot,
       run.run_id   AS run_id,
       cycle.number AS cycle,
       noise.joint  AS joint,
       noise.noise_nm,
       noise.relative_noise
FROM channel_noise AS noise
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
