-- How much torque a joint has: an error that is small beside the torque of the arm says nothing of its model.
ALTER TABLE run_joint_summary ADD COLUMN torque_rms_nm double precision;
