"""Reads the database with Python's own sqlite3, makes a copy of it, and lists events of alarms.

    python3 read_with_sqlite3.py DATABASE

If armwatch is stopped and your program cannot write to the database's folder, `mode=ro` fails with "attempt to write a
readonly database". Use `?immutable=1` then, but never while armwatch runs: `immutable` takes no locks and ignores the
write-ahead log.
"""

import os
import sqlite3
import sys
import tempfile

DATABASE = sys.argv[1]

# Status of each joint.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
for robot, joint, status, reason in connection.execute(
    "SELECT robot, joint, status, reason FROM fleet_health ORDER BY robot, joint"
):
    print(robot, joint, status, reason or "")
connection.close()

# New events only: anomaly_event_id only increases, so a polling program remembers the largest one it has read.
last_seen = 0
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
events = connection.execute(
    """SELECT anomaly_event_id, at, robot, joint, what, severity, message
       FROM anomaly_history
       WHERE anomaly_event_id > ?
       ORDER BY anomaly_event_id""",
    (last_seen,),
).fetchall()
connection.close()
for event in events:
    print(*event[1:6])
last_seen = events[-1][0] if events else last_seen

# A copy that does not change, to archive and to read without write permission. Making it does not block armwatch.
SNAPSHOT = os.path.join(tempfile.mkdtemp(), "snapshot.db")
source = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
target = sqlite3.connect(SNAPSHOT)
source.backup(target)
# one file, without a write-ahead log
target.execute("PRAGMA journal_mode = DELETE")
target.close()
source.close()
print(os.path.getsize(SNAPSHOT), "bytes")
