-- Delivery of alarms: which receiver has had which event. The events themselves are in `anomaly_event`, written in the
-- transaction that changes an anomaly, so that nothing is lost between a conclusion and its delivery.

-- Tells the alarms of this database from those of another one at a receiver of both.
CREATE TABLE database_identity (
    only_one INTEGER PRIMARY KEY CHECK (only_one = 1),
    identity TEXT NOT NULL
) STRICT;
INSERT INTO database_identity (only_one, identity) VALUES (1, lower(hex(randomblob(6))));

-- Anomalies from before events were kept: without an event, nobody would ever be told of them.
INSERT INTO anomaly_event (anomaly_id, at, what, severity, score, value, message)
SELECT anomaly_id, first_seen_at, 'opened', severity, score, value, message
FROM anomaly
WHERE state = 'open' AND NOT withdrawn AND anomaly_id NOT IN (SELECT anomaly_id FROM anomaly_event);

CREATE TABLE delivery_route (
    delivery_route_id INTEGER PRIMARY KEY AUTOINCREMENT,
    name              TEXT NOT NULL UNIQUE,
    -- Events up to this number have been looked at: they have a row in `delivery`, or the route does not want them.
    seen_event_id     INTEGER NOT NULL,
    -- Attempts in a row that did not reach the receiver, and when the next one is made; microseconds since 1970.
    failures          INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0),
    retry_at          INTEGER,
    -- Not in the configuration any more.
    retired           INTEGER NOT NULL DEFAULT 0 CHECK (retired IN (0, 1))
) STRICT;

CREATE TABLE delivery (
    delivery_id       INTEGER PRIMARY KEY AUTOINCREMENT,
    delivery_route_id INTEGER NOT NULL REFERENCES delivery_route ON DELETE CASCADE,
    anomaly_event_id  INTEGER NOT NULL REFERENCES anomaly_event ON DELETE CASCADE,
    state             TEXT NOT NULL CHECK (state IN ('pending', 'sent', 'failed', 'suppressed')),
    -- Why it is not sent at once.
    held              TEXT CHECK (held IN ('quiet', 'digest', 'flood')),
    -- The digest that it goes out with: the largest number of an event in it.
    digest            INTEGER,
    created_at        INTEGER NOT NULL,
    -- Not before this moment.
    due_at            INTEGER NOT NULL,
    attempts          INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    first_attempted_at INTEGER,
    attempted_at      INTEGER,
    sent_at           INTEGER,
    -- Of the latest attempt that failed, or why it is not sent at all.
    error             TEXT,
    -- What the receiver was told in the latest attempt, where it knows an alarm by its labels.
    told_kind         TEXT,
    told_severity     TEXT,
    UNIQUE (delivery_route_id, anomaly_event_id)
) STRICT;
CREATE INDEX delivery_by_event ON delivery (anomaly_event_id);
CREATE INDEX delivery_pending ON delivery (delivery_route_id, due_at) WHERE state = 'pending';
CREATE INDEX delivery_sent ON delivery (delivery_route_id, sent_at) WHERE state = 'sent';

-- The contract -------------------------------------------------------------------------------------

-- What each receiver has had of each event of an anomaly.
CREATE VIEW deliveries AS
SELECT delivery.delivery_id,
       delivery_route.name AS route,
       'armwatch-' || database_identity.identity || '-' || delivery.anomaly_event_id AS key,
       anomaly_event.anomaly_id,
       delivery.anomaly_event_id,
       robot.name AS robot,
       anomaly.joint,
       anomaly_event.what,
       anomaly_event.severity,
       delivery.state,
       delivery.held,
       delivery.digest,
       strftime('%Y-%m-%dT%H:%M:%fZ', delivery.due_at / 1000000.0, 'unixepoch') AS due_at,
       delivery.attempts,
       strftime('%Y-%m-%dT%H:%M:%fZ', delivery.attempted_at / 1000000.0, 'unixepoch') AS attempted_at,
       strftime('%Y-%m-%dT%H:%M:%fZ', delivery.sent_at / 1000000.0, 'unixepoch') AS sent_at,
       delivery.error
FROM delivery
JOIN delivery_route USING (delivery_route_id)
JOIN anomaly_event USING (anomaly_event_id)
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id)
CROSS JOIN database_identity;
