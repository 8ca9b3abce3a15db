-- Arms of one model are compared with each other.

-- With how many other arms of its model the latest conclusions have compared the robot.
ALTER TABLE robot ADD COLUMN peers_compared INTEGER NOT NULL DEFAULT 0;
