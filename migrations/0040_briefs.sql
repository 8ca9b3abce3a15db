-- Conclusions from a long history read the cycles of few tests: of the others they read what is known of them in brief, and
-- what was found in their cycles.

-- What a complete test comes to for each joint, a few numbers that stand for its cycles, and what was found in these, with the
-- hashes of all that this follows from (store::robot::run_brief has the formats). It follows from the series of the test
-- and goes with it; without a series there is none.
CREATE TABLE run_brief (
    run_id     INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    joints     BLOB NOT NULL,
    brief      BLOB NOT NULL,
    judgements BLOB NOT NULL
) STRICT;

CREATE TRIGGER run_brief_goes_with_series AFTER DELETE ON run_series
BEGIN
    DELETE FROM run_brief WHERE run_id = OLD.run_id;
END;
