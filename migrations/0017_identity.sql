-- What tells recordings apart, and what stored cycles were made with.

-- Hash of layout, description, settings and program that the stored cycles of a run were made with. Where another
-- one is to go on, the run is begun afresh; NULL, of earlier versions, is another one.
ALTER TABLE run ADD COLUMN made_with BLOB CHECK (length(made_with) = 32);

-- Hash of the first rows, in SI: a recording that is exported again begins with the same ones. NULL as long as a run
-- is not complete, and of runs of earlier versions.
ALTER TABLE run ADD COLUMN first_rows BLOB CHECK (length(first_rows) = 32);
