-- Where reading goes on after a restart.

-- The last place of an export between two cycles of its run: byte in the decompressed file at which reading goes
-- on, cycles that lie before it, and what reader, finder of stages and cutter know there, with its own version and
-- check. Moves in the transaction that stores a cycle. A hint only: without it, or where it does not fit, the
-- export is read from its start and the rows come out the same. It stays with a complete run, whose file may grow.
CREATE TABLE resume_point (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    cycles INTEGER NOT NULL CHECK (cycles >= 1),
    byte   INTEGER NOT NULL CHECK (byte >= 0),
    state  BLOB NOT NULL
) STRICT;
