"""Reads the files of `armwatch export --parquet FOLDER` with pandas, polars and DuckDB.

    python3 read_parquet.py PARQUET

Times are UTC timestamps, days are dates, unknown values are NULL. Each field's metadata has `unit`, `description` and, if
it can be NULL, `null_when`. The file's metadata repeats them as JSON (`armwatch.columns`).
"""

import sys

import duckdb
import pandas as pd
import polars as pl
import pyarrow.parquet as pq

PARQUET = sys.argv[1]

# pandas, with the units of the columns.
index = pd.read_parquet(f"{PARQUET}/friction_index.parquet")
print(index.groupby(["robot", "joint"])["friction_index"].agg(["count", "last", "std"]).round(4).head())
print(index["started_at"].dtype)
for field in pq.read_schema(f"{PARQUET}/friction_index.parquet"):
    print(field.name, field.type, field.metadata.get(b"unit", b"").decode(), field.metadata[b"description"].decode())

# polars, lazily: it reads only the needed columns and row groups.
rmsd = (
    pl.scan_parquet(f"{PARQUET}/cycle_rmsd.parquet")
    .filter(stage="excitation", verification="self")
    .join(pl.scan_parquet(f"{PARQUET}/runs.parquet").select("run_id", "started_at"), on="run_id")
    .group_by("robot", "joint", pl.col("started_at").dt.truncate("1d").alias("day"))
    .agg(pl.col("moving_relative_rmsd").median())
    .sort("robot", "joint", "day")
    .collect()
)
print(rmsd.head())

# DuckDB reads a file as a table, and several exports with a pattern such as '*/runs.parquet'.
db = duckdb.connect()
print(
    db.sql(
        f"""SELECT robot, joint, date_trunc('week', started_at) AS week, max(friction_index) AS highest
            FROM '{PARQUET}/friction_index.parquet'
            GROUP BY ALL
            ORDER BY highest DESC
            LIMIT 10"""
    ).pl()
)
print(
    db.sql(
        f"""SELECT of.name, of.unit, of.description
            FROM (
                SELECT unnest(from_json(decode(value), '[{{"name": "VARCHAR", "unit": "VARCHAR", "description": "VARCHAR"}}]'))
                           AS of
                FROM parquet_kv_metadata('{PARQUET}/friction_index.parquet')
                WHERE decode(key) = 'armwatch.columns'
            )"""
    ).pl()
)
db.close()
