-- How much torque a joint has: an error that is small beside the torque of the arm says nothing of its model.

-- RMS of the torque while the joint moves in the excitation, Nm: median over the cycles of a test. NULL for tests that
-- were stored before.
ALTER TABLE run_joint_summary ADD COLUMN torque_rms_nm REAL;
