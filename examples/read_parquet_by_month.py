"""Reads the folders of `armwatch export --parquet FOLDER --by-month` with DuckDB, polars and DataFusion.

    python3 read_parquet_by_month.py HISTORY

The types keep robot names such as `007` as text.
"""

import sys

import datafusion
import duckdb
import polars as pl
import pyarrow as pa

HISTORY = sys.argv[1]

# Friction of robots by month in DuckDB.
db = duckdb.connect()
print(
    db.sql(
        f"""SELECT robot, month, joint, median(friction_index) AS median_index, count(*) AS tests
            FROM read_parquet('{HISTORY}/friction_index/*/*/*.parquet',
                              hive_types = {{'robot': VARCHAR, 'month': VARCHAR}})
            GROUP BY ALL
            ORDER BY median_index DESC
            LIMIT 10"""
    ).pl()
)
db.close()

# The same in polars.
print(
    pl.scan_parquet(f"{HISTORY}/friction_index/", hive_schema={"robot": pl.String, "month": pl.String})
    .group_by("robot", "month", "joint")
    .agg(pl.col("friction_index").median(), pl.len().alias("tests"))
    .sort("friction_index", descending=True, nulls_last=True)
    .head(10)
    .collect()
)

# The same in DataFusion.
context = datafusion.SessionContext()
context.register_parquet(
    "friction_index",
    f"{HISTORY}/friction_index/",
    table_partition_cols=[("robot", pa.string()), ("month", pa.string())],
)
print(
    context.sql(
        """SELECT robot, month, joint, median(friction_index) AS median_index, count(*) AS tests
           FROM friction_index
           GROUP BY robot, month, joint
           ORDER BY median_index DESC NULLS LAST
           LIMIT 10"""
    )
)
