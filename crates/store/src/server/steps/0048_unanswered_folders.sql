-- Commands that ask the database say which watched folders do not answer.
CREATE TABLE unanswered_folder (
    host text COLLATE "C" NOT NULL,
    folder text COLLATE "C" NOT NULL,
    looked_at bigint,
    PRIMARY KEY (host, folder)
);
