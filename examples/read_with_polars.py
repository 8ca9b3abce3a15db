"""Reads the database with polars.

    python3 read_with_polars.py DATABASE

`infer_schema_length=None` reads all rows before it decides on a type; otherwise a column whose first hundred rows are
NULL fails. `schema_overrides` sets the type of columns that may be empty.
"""

import os
import sqlite3
import sys

import polars as pl

DATABASE = sys.argv[1]

# Cycles by robot and status.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
cycles = pl.read_database(
    "SELECT * FROM cycles", connection, infer_schema_length=None, schema_overrides={"started_at": pl.String}
)
connection.close()
cycles = cycles.with_columns(pl.col("started_at").str.to_datetime("%Y-%m-%dT%H:%M:%S%.3fZ", time_zone="UTC"))
print(cycles.group_by("robot", "status").agg(pl.len().alias("cycles"), pl.col("started_at").max()).sort("robot"))

# Fall of friction while the arm warms up, from the first to the last cycle of each test.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
points = pl.read_database(
    """SELECT robot, run_id, joint, cycle, speed_fraction, torque_nm, started_at
       FROM friction_points
       JOIN runs USING (run_id, robot)
       WHERE runs.status = 'complete' AND runs.kind = 'test' AND speed_fraction BETWEEN 0.59 AND 0.61""",
    connection,
    infer_schema_length=None,
    schema_overrides={"torque_nm": pl.Float64, "cycle": pl.Int64},
)
connection.close()
by_cycle = points.group_by("robot", "run_id", "joint", "cycle").agg(
    pl.col("torque_nm").abs().mean().alias("friction_nm")
)
fall = (
    by_cycle.sort("cycle")
    .group_by("robot", "run_id", "joint")
    .agg((pl.col("friction_nm").last() / pl.col("friction_nm").first()).alias("warm_over_cold"))
)
print(fall.group_by("robot", "joint").agg(pl.col("warm_over_cold").mean().round(3)).sort("robot", "joint"))

# read_database_uri (connectorx) is fast for long views. It takes the type of a computed column from the first row and fails
# with "Cannot infer type from null" if that is NULL: order such rows last, or use read_database. It returns computed columns
# of an empty view as text. Computed columns that may be NULL: relative_std_error, interval_low and interval_high of
# cycle_parameters and reestimated_parameters, slow_min and slow_std_error_min of friction_map, joint of temperatures,
# seen_by_joint, content_hash of runs, reason of fleet_health and production_checks.
uri = "sqlite://" + os.path.abspath(DATABASE)
rmsd = pl.read_database_uri("SELECT * FROM cycle_rmsd", uri)
health = pl.read_database_uri("SELECT * FROM fleet_health ORDER BY reason IS NULL, robot, joint", uri)
print(rmsd.schema)
print(health.select("robot", "joint", "status", "friction_index").head())
