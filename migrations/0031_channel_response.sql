-- How identified parameters answer to channels that read wrong.

-- Of the latest of the first cycles of a test: parameters in their order, joined by spaces, and for each fault (gain and
-- offset of a torque, offset of a position), each of three strengths of it and each joint the changes of the parameters,
-- then the unexplained torque of each joint, as numbers of 4 bytes, little-endian.
CREATE TABLE channel_response (
    run_id     INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    parameters TEXT NOT NULL,
    numbers    BLOB NOT NULL
) STRICT;
