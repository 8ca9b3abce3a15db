"""Reads the database with pandas.

    python3 read_with_pandas.py DATABASE

`dtype_backend="numpy_nullable"` keeps integers with NULL as integers. `pd.to_datetime` with `utc=True` parses times and
gives an empty column the right type.
"""

import sqlite3
import sys

import numpy as np
import pandas as pd

DATABASE = sys.argv[1]

# Number of tests per robot.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
runs = pd.read_sql_query(
    "SELECT run_id, robot, started_at, cycles, rows_skipped FROM runs WHERE status = 'complete' AND kind = 'test'",
    connection,
    dtype_backend="numpy_nullable",
)
connection.close()
runs["started_at"] = pd.to_datetime(runs["started_at"], utc=True)
print(runs.groupby("robot").agg(tests=("run_id", "count"), first=("started_at", "min"), last=("started_at", "max")))

# Change of each joint's friction in 30 days, as a fraction of its baseline, by weighted least squares over all tests.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
index = pd.read_sql_query(
    """SELECT robot, joint, started_at, friction_index, friction_index_std_error
       FROM friction_index
       WHERE friction_index_std_error > 0""",
    connection,
)
connection.close()
index["started_at"] = pd.to_datetime(index["started_at"], utc=True)
index["month"] = (index["started_at"] - index["started_at"].min()) / pd.Timedelta(days=30)


def slope(rows):
    if len(rows) < 3:
        return np.nan
    return np.polyfit(rows["month"], rows["friction_index"], 1, w=1 / rows["friction_index_std_error"])[0]


trend = {joint: slope(rows) for joint, rows in index.groupby(["robot", "joint"])}
print(pd.Series(trend, dtype=float).sort_values(ascending=False).round(4).head(10))

# Tests with unusual RMSD, in scaled median absolute deviations of the same robot and joint.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
rmsd = pd.read_sql_query(
    """SELECT robot, run_id, joint, started_at, avg(moving_relative_rmsd) AS rmsd
       FROM cycle_rmsd
       JOIN runs USING (run_id, robot)
       WHERE stage = 'excitation' AND verification = 'self' AND runs.status = 'complete' AND runs.kind = 'test'
       GROUP BY robot, run_id, joint, started_at""",
    connection,
)
connection.close()
of_joint = rmsd.groupby(["robot", "joint"])["rmsd"]
distance = rmsd["rmsd"] - of_joint.transform("median")
scale = 1.4826 * distance.abs().groupby([rmsd["robot"], rmsd["joint"]]).transform("median")
rmsd["deviations"] = distance / scale.where(scale > 0)
print(rmsd.sort_values("deviations", ascending=False).head(10))

# Parameters as a wide table for statistics, one row per cycle and one column per parameter.
connection = sqlite3.connect(f"file:{DATABASE}?mode=ro", uri=True)
parameters = pd.read_sql_query(
    """SELECT robot, run_id, cycle, joint, parameter, value
       FROM cycle_parameters
       JOIN runs USING (run_id, robot)
       WHERE runs.status = 'complete'""",
    connection,
)
connection.close()
parameters["name"] = "J" + parameters["joint"].astype(str) + "_" + parameters["parameter"]
wide = parameters.pivot(index=["robot", "run_id", "cycle"], columns="name", values="value")
print(wide.shape)
print(wide.groupby("robot").std().mean().sort_values(ascending=False).head())
