#!/usr/bin/env python3
"""Makes a fleet of many robots out of a database of few: many_robots.py DATABASE COPY ROBOTS.

Every robot is copied under new names until there are ROBOTS of them, with its runs, friction indices, baselines and
anomalies: what the fleet page and the lists show. Cycles, factors and points stay with the first ones.
"""

import sqlite3
import sys

source, copy, wanted = sys.argv[1], sys.argv[2], int(sys.argv[3])
with sqlite3.connect(f"file:{source}?mode=ro", uri=True) as old, sqlite3.connect(copy) as new:
    old.backup(new)
db = sqlite3.connect(copy)
db.execute("PRAGMA foreign_keys = ON")

# tables that are copied, each after those that it refers to
TABLES = [
    "robot", "run", "joint_health", "friction_law", "friction_level", "friction_baseline", "friction_baseline_run",
    "run_friction", "run_friction_index", "run_joint_summary", "anomaly", "anomaly_event",
]
NUMBERS = {"robot_id": "robot", "run_id": "run", "friction_baseline_id": "friction_baseline", "anomaly_id": "anomaly",
           "anomaly_event_id": "anomaly_event"}
RUNS = ("replaces_run_id", "superseded_by_run_id", "first_run_id", "last_run_id", "onset_run_id", "open_run_id",
        "last_result_run_id")


def written(table):
    """Columns that are stored, not computed."""
    return [row[1] for row in db.execute(f"PRAGMA table_xinfo({table})") if row[6] == 0]


robots = db.execute("SELECT count(*) FROM robot").fetchone()[0]
step = {key: db.execute(f"SELECT max({key}) FROM {table}").fetchone()[0] or 0 for key, table in NUMBERS.items()}
rows = {table: db.execute(f"SELECT {', '.join(written(table))} FROM {table}").fetchall() for table in TABLES}
robot_ids = [row[0] for row in db.execute("SELECT robot_id FROM robot ORDER BY robot_id")]

for turn in range(1, -(-wanted // robots)):
    last = set(robot_ids[: wanted - turn * robots])
    kept = {key: set() for key in NUMBERS}
    for table in TABLES:
        columns = written(table)
        for row in rows[table]:
            cells = dict(zip(columns, row))
            owner = next((key for key in ("robot_id", "run_id", "friction_baseline_id", "anomaly_id") if key in cells), None)
            if not (cells[owner] in last if owner == "robot_id" else cells[owner] in kept[owner]):
                continue
            for key, of in NUMBERS.items():
                if of == table:
                    kept[key].add(cells[key])
            for key in cells:
                number = "run_id" if key in RUNS else key
                if number in step and cells[key] is not None:
                    cells[key] += turn * step[number]
            if table == "robot":
                cells["name"] += f"-{turn:03d}"
            if table == "run":
                cells["source_path"] += f".{turn}"
                cells["content_hash"] = cells["content_hash"] and bytes(cells["content_hash"][:-2]) + turn.to_bytes(2) \
                    if isinstance(cells["content_hash"], bytes) else f"{turn:04x}{cells['content_hash'][4:]}"
            marks = ", ".join("?" * len(cells))
            db.execute(f"INSERT INTO {table} ({', '.join(cells)}) VALUES ({marks})", list(cells.values()))
db.commit()
print(*(f"{table} {db.execute(f'SELECT count(*) FROM {table}').fetchone()[0]}" for table in TABLES), sep="\n")
