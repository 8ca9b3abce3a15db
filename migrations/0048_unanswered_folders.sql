-- Commands that ask the database say which watched folders do not answer.

-- Watched folders whose disk or file server does not answer the daemon of a host. A row goes when the folder answers
-- again, and when the daemon starts.
CREATE TABLE unanswered_folder (
    -- The name that --host or [cluster] gives; empty without one.
    host      TEXT NOT NULL,
    folder    TEXT NOT NULL,
    -- When the daemon last looked into it, microseconds since 1970; NULL if not since its start.
    looked_at INTEGER,
    PRIMARY KEY (host, folder)
) STRICT, WITHOUT ROWID;
