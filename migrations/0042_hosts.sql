-- Several daemons on one database: which is at work, what each has claimed, and which read a run. A database in a file has one
-- daemon, so that these tables stay empty there.

-- A program that may write, from its start to its end. Its number is the epoch of its lease: a session that has ended never
-- begins again.
CREATE TABLE host_session (
    host_session_id INTEGER PRIMARY KEY AUTOINCREMENT,
    -- The name that --host or [cluster] gives; empty without one.
    host        TEXT NOT NULL,
    kind        TEXT NOT NULL CHECK (kind IN ('daemon', 'command')),
    version     TEXT NOT NULL,
    started_at  INTEGER NOT NULL,
    seen_at     INTEGER NOT NULL,
    -- When the lease ends unless it is renewed.
    alive_until INTEGER NOT NULL,
    ended_at    INTEGER,
    end_reason  TEXT CHECK (end_reason IN ('stopped', 'restarted', 'lease_ended')),
    started_at_text TEXT,
    seen_at_text TEXT,
    CHECK ((ended_at IS NULL) = (end_reason IS NULL))
) STRICT;

CREATE TRIGGER host_session_times_as_text AFTER INSERT ON host_session
BEGIN
    UPDATE host_session
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.seen_at / 1000000.0, 'unixepoch')
    WHERE host_session_id = NEW.host_session_id;
END;
CREATE TRIGGER host_session_times_change AFTER UPDATE OF started_at, seen_at ON host_session
BEGIN
    UPDATE host_session
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.seen_at / 1000000.0, 'unixepoch')
    WHERE host_session_id = NEW.host_session_id;
END;

CREATE INDEX host_session_alive ON host_session (alive_until) WHERE ended_at IS NULL;
CREATE INDEX host_session_by_host ON host_session (host, host_session_id);

-- What one session works on and no other may: an export in a shared folder, a run that is being read, conclusions of a
-- robot, a route of alarms. Goes with the end of the session.
CREATE TABLE claim (
    kind            TEXT NOT NULL CHECK (kind IN ('export', 'run', 'robot', 'route')),
    subject         TEXT NOT NULL,
    host_session_id INTEGER NOT NULL REFERENCES host_session ON DELETE CASCADE,
    claimed_at      INTEGER NOT NULL,
    PRIMARY KEY (kind, subject)
) STRICT, WITHOUT ROWID;

CREATE INDEX claim_by_session ON claim (host_session_id);

-- The session that reads a run, or has read it last.
ALTER TABLE run ADD COLUMN host_session_id INTEGER REFERENCES host_session;

CREATE INDEX run_by_session ON run (host_session_id) WHERE host_session_id IS NOT NULL;

-- Whether an export may have the content of another is asked by its size first.
CREATE INDEX run_by_bytes ON run (source_bytes);

DROP VIEW runs;

CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       run.started_at_text AS started_at,
       run.source_name,
       CASE WHEN NOT run.growing THEN lower(hex(run.content_hash)) END AS content_hash,
       run.rows,
       run.sample_rate_hz,
       run.cycles_stored AS cycles,
       CASE WHEN run.superseded_by_run_id IS NULL THEN run.status ELSE 'superseded' END AS status,
       run.reason,
       run.reason_line,
       run.reason_column,
       run.model,
       run.superseded_by_run_id,
       run.kind,
       run.rows_skipped,
       nullif(host_session.host, '') AS host
FROM run
JOIN robot USING (robot_id)
LEFT JOIN host_session USING (host_session_id);

-- The latest session of each host. On a server it tells by the clock which of them are silent; in a file there is none,
-- and DuckDB, which computes views itself, has no function for the clock that SQLite has too.
CREATE VIEW hosts AS
SELECT latest.host,
       CASE WHEN latest.ended_at IS NOT NULL THEN 'ended'
            ELSE 'at_work' END AS state,
       latest.end_reason,
       latest.version,
       latest.started_at_text AS started_at,
       latest.seen_at_text AS seen_at,
       (SELECT count(*) FROM claim WHERE claim.host_session_id = latest.host_session_id AND claim.kind = 'run') AS runs_in_work,
       (SELECT count(*) FROM host_session AS own JOIN run USING (host_session_id) WHERE own.host = latest.host) AS runs
FROM host_session AS latest
WHERE latest.kind = 'daemon'
  AND latest.host_session_id = (SELECT max(own.host_session_id) FROM host_session AS own
                                WHERE own.host = latest.host AND own.kind = 'daemon');
