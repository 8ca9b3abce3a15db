-- Friction of the excitation, for runs without friction points: the identified friction at a speed that the joint
-- reaches, over the last third of the run's cycles. Of runs of earlier versions it is not known.
ALTER TABLE run_joint_summary ADD COLUMN excitation_friction_nm REAL;
ALTER TABLE run_joint_summary ADD COLUMN excitation_friction_std_error_nm REAL;
-- Mean time of these cycles: runs compare at equal warmth only.
ALTER TABLE run_joint_summary ADD COLUMN excitation_minute REAL;
-- As a fraction of the joint's largest speed.
ALTER TABLE run_joint_summary ADD COLUMN excitation_speed_fraction REAL;
