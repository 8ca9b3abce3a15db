-- What the columns of the public views mean: filled from docs/schema.md whenever the program opens the database to write.

CREATE TABLE view_column (
    view_name TEXT NOT NULL,
    column_name TEXT NOT NULL,
    position INTEGER NOT NULL,
    type TEXT NOT NULL,
    unit TEXT,
    null_when TEXT,
    meaning TEXT NOT NULL,
    PRIMARY KEY (view_name, position)
) STRICT;

CREATE VIEW view_columns AS
SELECT view_name,
       column_name,
       position,
       type,
       unit,
       CASE WHEN null_when IS NULL THEN 0 ELSE 1 END AS nullable,
       null_when,
       meaning
FROM view_column;
