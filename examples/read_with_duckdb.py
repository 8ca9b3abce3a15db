"""Reads the database with DuckDB, which joins views with CSV, Parquet and tables of pandas or polars.

    python3 read_with_duckdb.py DATABASE

The first ATTACH downloads the extension `sqlite`. Without a network, install `duckdb-extensions` and
`duckdb-extension-sqlite-scanner` and call `duckdb_extensions.import_extension("sqlite_scanner")` once.

`.df()` returns a pandas table, `.pl()` a polars table. `CAST(started_at AS TIMESTAMP)` converts times (UTC). Quote the
columns "at" (anomaly_history, maintenance_log) and "window" (parameter_statistics, reestimated_statistics), because they
are words of DuckDB's SQL. DuckDB lacks SQLite functions such as strftime(.., 'unixepoch') and julianday. Pass statements
that need them to SQLite with FROM sqlite_query('arm', 'SELECT ...'); all columns are then text.
"""

import sys

import duckdb

DATABASE = sys.argv[1]

# Friction index per joint.
db = duckdb.connect()
db.execute(f"ATTACH '{DATABASE}' AS arm (TYPE sqlite, READ_ONLY)")
print(db.sql("DESCRIBE arm.fleet_health").fetchall()[:5])
print(
    db.sql(
        """SELECT robot, joint, count(*) AS tests,
                  median(friction_index) AS median_index,
                  stddev(friction_index) AS scatter,
                  max(CAST(started_at AS TIMESTAMP)) AS last_at
           FROM arm.friction_index
           GROUP BY robot, joint
           ORDER BY scatter DESC NULLS LAST
           LIMIT 10"""
    )
)
db.close()

# Correlation between the mean of each parameter and its joint's friction index over tests. SQLite has no corr, median or
# quantile_cont.
db = duckdb.connect()
db.execute(f"ATTACH '{DATABASE}' AS arm (TYPE sqlite, READ_ONLY)")
together = db.sql(
    """SELECT robot, joint, parameter, count(*) AS tests, corr(mean, friction_index) AS correlation
       FROM arm.parameter_statistics
       JOIN arm.friction_index USING (run_id, robot, joint)
       WHERE "window" = 'all'
       GROUP BY robot, joint, parameter
       HAVING count(*) >= 6 AND stddev(mean) > 0 AND stddev(friction_index) > 0
       ORDER BY abs(correlation) DESC
       LIMIT 10"""
).df()
print(together)
db.close()

# JSON functions open JSON text such as anomalies.alternatives and baselines.levels.
db = duckdb.connect()
db.execute(f"ATTACH '{DATABASE}' AS arm (TYPE sqlite, READ_ONLY)")
levels = db.sql(
    """SELECT robot, joint, epoch, level.speed_fraction, level.warm_nm, level.cold_nm
       FROM (
           SELECT DISTINCT robot, joint, epoch,
                  unnest(from_json(levels, '[{"speed_fraction": "DOUBLE", "warm_nm": "DOUBLE", "cold_nm": "DOUBLE"}]'))
                      AS level
           FROM arm.baselines
           WHERE levels IS NOT NULL
       )
       ORDER BY robot, joint, epoch, level.speed_fraction"""
).pl()
print(levels.head())
db.close()
