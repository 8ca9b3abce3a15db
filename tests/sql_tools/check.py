"""Checks the views of a database with the tools that people read them with.

    python3 check.py DATABASE [--parquet FOLDER] [--history FOLDER] [--docs FOLDER] [--tool NAME]...

Every view opens in every tool; its columns are those of schema.md, numbers arrive as numbers, and times as text in one
form whose order is that of time. Every statement of questions.sql and every Python script in `examples` runs. These files
and schema.md are searched in FOLDER, else in `docs` and `examples` next to or above this file. The database is only read.

With --parquet, a folder that `armwatch export --parquet` has made of the same database: pyarrow, polars and DuckDB find
in each file the values of the view, with the types and units of schema.md. Scripts that read PARQUET run.
With --history, a folder of `armwatch export --parquet --by-month`, DuckDB, polars and DataFusion find the values of each
view that is divided, and scripts that read HISTORY run.

Ends with 0, with 1 and a sentence for each thing that is wrong, or with 2 where nothing could be checked.
requirements.txt has the tools.
"""

import argparse
import asyncio
import collections
import contextlib
import datetime
import json
import os
import pathlib
import re
import sqlite3
import subprocess
import sys
import time

TOOLS = ("sqlite3", "pandas", "polars", "connectorx", "duckdb", "datasette", "parquet", "history", "questions", "python")
TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")
# Columns of text that hold a time, by their names.
TIME_COLUMN = re.compile(r"(.*_)?at$|shelved_until$|expected_by$")
# A statement of questions.sql that takes longer is of no use on a page that is loaded again and again.
SLOWEST_S = 0.5
# connectorx takes the type of a computed column from its first row.
FIRST_ROW_IS_NULL = "Cannot infer type from null"

problems = []


def wrong(tool, sentence):
    problems.append(f"{tool}: {sentence}")


def brief(error):
    """The first line of an error; some repeat the whole statement in it."""
    line = (str(error).splitlines() or [""])[0]
    return line if len(line) <= 200 else f"{line[:120]} ... {line[-70:]}"


def read_schema(path):
    """Columns with their types by view, as schema.md states them."""
    views, view, common = {}, None, {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if heading := re.match(r"## `(\w+)`$", line):
            view = views.setdefault(heading[1], {})
        elif line.startswith("## "):
            view = common
        elif view is not None and (row := re.match(r"\| (`\w+`(?:, `\w+`)*) \| (?:(integer|real|text)\b[^|]*)?\|", line)):
            for column in re.findall(r"\w+", row[1]):
                view[column] = row[2] or common[column]
    return {name: columns for name, columns in views.items() if columns}


def connect(database):
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
    connection.execute("PRAGMA query_only = ON")
    return connection


def views_of(connection):
    return [row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'view' ORDER BY name")]


def check_sqlite3(database, schema):
    connection = connect(database)
    found = views_of(connection)
    for view in sorted(set(schema) ^ set(found)):
        wrong("sqlite3", f"the view {view} is in {'schema.md only' if view in schema else 'the database only'}")
    for view in found:
        columns = schema.get(view, {})
        cursor = connection.execute(f'SELECT * FROM "{view}"')
        names = [column[0] for column in cursor.description]
        if names != list(columns):
            wrong("sqlite3", f"{view} has the columns {', '.join(names)}; schema.md has {', '.join(columns)}")
            continue
        rows = cursor.fetchall()
        for place, (column, kind) in enumerate(columns.items()):
            values = [row[place] for row in rows if row[place] is not None]
            python = {"integer": int, "real": float, "text": str}[kind]
            other = sorted({type(value).__name__ for value in values if type(value) is not python})
            if other:
                wrong("sqlite3", f"{view}.{column} is {kind} and holds {', '.join(other)}")
            if kind == "text" and TIME_COLUMN.match(column):
                strange = next((value for value in values if not TIME.fullmatch(str(value))), None)
                if strange is not None:
                    wrong("sqlite3", f"{view}.{column} holds {strange!r}, which is no time with milliseconds and Z")
    connection.close()


def check_pandas(database, schema):
    import pandas as pd

    connection = connect(database)
    for view, columns in schema.items():
        try:
            table = pd.read_sql_query(f'SELECT * FROM "{view}"', connection)
        except Exception as error:
            wrong("pandas", f"{view} cannot be read: {brief(error)}")
            continue
        for column, kind in columns.items():
            values = table[column].dropna()
            if kind != "text" and len(values) and not pd.api.types.is_numeric_dtype(table[column]):
                wrong("pandas", f"{view}.{column} is {kind} and arrives as {table[column].dtype}")
            if kind == "text" and TIME_COLUMN.match(column) and len(values):
                try:
                    times = pd.to_datetime(values)
                except Exception as error:
                    wrong("pandas", f"{view}.{column} cannot be read as times: {brief(error)}")
                    continue
                if not times.loc[values.sort_values(kind="stable").index].is_monotonic_increasing:
                    wrong("pandas", f"the order of {view}.{column} as text is not that of time")
    connection.close()


def polars_fits(kind, kind_of_polars):
    if kind == "integer":
        return kind_of_polars.is_integer()
    if kind == "real":
        return kind_of_polars.is_float()
    return str(kind_of_polars) == "String"


def check_polars(database, schema):
    import polars as pl

    connection = connect(database)
    for view, columns in schema.items():
        try:
            table = pl.read_database(f'SELECT * FROM "{view}"', connection, infer_schema_length=None)
        except Exception as error:
            wrong("polars", f"{view} cannot be read: {brief(error)}")
            continue
        for column, kind in columns.items():
            if table[column].null_count() < len(table) and not polars_fits(kind, table.schema[column]):
                wrong("polars", f"{view}.{column} is {kind} and arrives as {table.schema[column]}")
    connection.close()


def check_connectorx(database, schema):
    """`read_database_uri`. A computed column whose first row is NULL cannot be read so: that is said, and no fault."""
    import polars as pl

    for view, columns in schema.items():
        try:
            # connectorx writes the place of an error that it hands on to the standard error too
            with silent():
                table = pl.read_database_uri(f'SELECT * FROM "{view}"', f"sqlite://{os.path.abspath(database)}")
        except BaseException as error:  # its panics are no Exception
            if FIRST_ROW_IS_NULL not in str(error):
                wrong("connectorx", f"{view} cannot be read: {brief(error)}")
            else:
                print(f"connectorx: {view} has a computed column that is NULL in the first row; take read_database")
            continue
        for column, kind in columns.items():
            if table[column].null_count() < len(table) and not polars_fits(kind, table.schema[column]):
                wrong("connectorx", f"{view}.{column} is {kind} and arrives as {table.schema[column]}")


@contextlib.contextmanager
def silent():
    """Nothing of what a library writes to the standard error by itself."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def load_sqlite_of_duckdb(duckdb):
    """Whether DuckDB can read SQLite: with the extension at hand, from its package, or from DuckDB's server."""
    ways = [lambda db: db.execute("LOAD sqlite_scanner"), from_package, lambda db: db.execute("INSTALL sqlite")]
    reasons = []
    for way in ways:
        with duckdb.connect() as db:
            try:
                way(db)
                db.execute("LOAD sqlite_scanner")
                return True
            except Exception as error:
                reasons.append(brief(error))
    wrong("duckdb", f"its extension sqlite_scanner is not to be had: {reasons[-1]}")
    return False


def from_package(db):
    import duckdb_extensions

    duckdb_extensions.import_extension("sqlite_scanner", con=db)


DUCKDB_TYPES = {"integer": {"TINYINT", "SMALLINT", "INTEGER", "BIGINT"}, "real": {"DOUBLE"}, "text": {"VARCHAR"}}


def check_duckdb(database, schema):
    import duckdb

    if not load_sqlite_of_duckdb(duckdb):
        return
    connection = connect(database)
    db = duckdb.connect()
    db.execute(f"ATTACH '{database}' AS arm (TYPE sqlite, READ_ONLY)")
    for view, columns in schema.items():
        try:
            described = {row[0]: row[1] for row in db.execute(f'DESCRIBE arm."{view}"').fetchall()}
            rows = db.execute(f'SELECT * FROM arm."{view}"').fetchall()
        except Exception as error:
            wrong("duckdb", f"{view} cannot be read: {brief(error)}")
            continue
        mistyped = [
            f"{column} ({described.get(column)})"
            for column, kind in columns.items()
            if described.get(column) not in DUCKDB_TYPES[kind]
        ]
        if mistyped:
            share = f"{len(mistyped)} of {len(columns)}"
            wrong("duckdb", f"{view} has {share} columns of another type: {', '.join(mistyped)}")
            continue
        expected = connection.execute(f'SELECT * FROM "{view}"').fetchall()
        if counted(rows) != counted(expected):
            wrong("duckdb", f"{view} has other values than in SQLite")
    db.close()
    connection.close()


def counted(rows):
    """Rows without their order; figures to 12 digits, since a sum may be rounded in another order."""
    rounded = lambda value: f"{value:.12g}" if isinstance(value, float) else value
    return collections.Counter(tuple(rounded(value) for value in row) for row in rows)


def check_datasette(database, schema):
    from datasette.app import Datasette

    async def ask():
        server = Datasette([database], settings={"max_returned_rows": 1000})
        # It may run in this process alone: no port is opened.
        name = next(name for name in server.databases if name != "_internal")
        for view, columns in schema.items():
            answer = await server.client.get(f"/{name}/{view}.json?_shape=array&_size=max")
            if answer.status_code != 200:
                wrong("datasette", f"{view} answers {answer.status_code}: {answer.text[:200]}")
                continue
            for column, kind in columns.items():
                values = [row[column] for row in answer.json() if row[column] is not None]
                # JSON of a whole real may come without a point
                good = {"integer": int, "real": (int, float), "text": str}[kind]
                if any(not isinstance(value, good) for value in values):
                    wrong("datasette", f"{view}.{column} is {kind} and arrives as another type")

    asyncio.run(ask())


ARROW_TYPES = {"integer": "int64", "real": "double", "text": "string"}
ARROW_TIMES = {"UTC": "timestamp[ms, tz=UTC]", "UTC day": "date32[day]"}
EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)


def check_parquet(database, schema, folder):
    """Each file in pyarrow, polars and DuckDB: fields with types and units, and the values that SQLite has."""
    import duckdb
    import polars as pl
    import pyarrow.parquet as pq

    connection = connect(database)
    described = collections.defaultdict(dict)
    for view, column, unit, meaning in connection.execute(
        "SELECT view_name, column_name, unit, meaning FROM view_columns ORDER BY view_name, position"
    ):
        described[view][column] = (unit, meaning)
    db = duckdb.connect()
    db.execute("SET TimeZone = 'UTC'")
    for view, columns in schema.items():
        path = os.path.join(folder, f"{view}.parquet")
        expected = counted(connection.execute(f'SELECT * FROM "{view}"').fetchall())
        try:
            table = pq.read_table(path)
            rows = {
                "pyarrow": as_rows(table),
                "polars": pl.read_parquet(path).rows(),
                "duckdb": as_rows(db.execute("SELECT * FROM read_parquet(?)", [path]).to_arrow_table()),
            }
        except Exception as error:
            wrong("parquet", f"{path} cannot be read: {brief(error)}")
            continue
        for field, (column, kind) in zip(table.schema, columns.items(), strict=True):
            unit, meaning = described[view][column]
            arrow = ARROW_TIMES.get(unit, ARROW_TYPES[kind])
            told = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
            if (field.name, str(field.type)) != (column, arrow):
                wrong("parquet", f"{view}.{column} is {arrow} and arrives as {field.name} {field.type}")
            if (told.get("unit"), told.get("description")) != (unit, meaning):
                wrong("parquet", f"{view}.{column} has other metadata: {told}")
        of_file = json.loads(pq.read_metadata(path).metadata[b"armwatch.columns"])
        if {of["name"]: (of["unit"], of["description"]) for of in of_file} != described[view]:
            wrong("parquet", f"{view} has other metadata of the file than view_columns")
        for tool, found in rows.items():
            if counted(tuple(as_in_sqlite(value) for value in row) for row in found) != expected:
                wrong("parquet", f"{view} has other values in {tool} than in SQLite")
    db.close()
    connection.close()


def check_history(database, schema, folder):
    """Each folder of files in DuckDB, polars and DataFusion: the values that SQLite has."""
    import datafusion
    import duckdb
    import polars as pl
    import pyarrow as pa

    connection = connect(database)
    db = duckdb.connect()
    db.execute("SET TimeZone = 'UTC'")
    divided = [view for view in schema if os.path.isdir(os.path.join(folder, view))]
    if len(divided) < 10:
        wrong("history", f"{folder} has {len(divided)} views that are divided")
    for view in divided:
        path, columns = os.path.join(folder, view) + "/", list(schema[view])
        names = ", ".join(f'"{column}"' for column in columns)
        expected = counted(connection.execute(f'SELECT {names} FROM "{view}"').fetchall())
        try:
            context = datafusion.SessionContext()
            parts = [("robot", pa.string()), ("month", pa.string())]
            context.register_parquet(view, path, table_partition_cols=parts)
            types = {"robot": pl.String, "month": pl.String}
            of_duckdb = f"SELECT {names} FROM read_parquet(?, hive_types = {{'robot': VARCHAR, 'month': VARCHAR}})"
            rows = {
                "duckdb": as_rows(db.execute(of_duckdb, [path + "*/*/*.parquet"]).to_arrow_table()),
                "polars": pl.scan_parquet(path, hive_schema=types).select(columns).collect().rows(),
                "datafusion": as_rows(context.sql(f'SELECT {names} FROM "{view}"').to_arrow_table()),
            }
        except Exception as error:
            wrong("history", f"{path} cannot be read: {brief(error)}")
            continue
        for tool, found in rows.items():
            if counted(tuple(as_in_sqlite(value) for value in row) for row in found) != expected:
                wrong("history", f"{view} has other values in {tool} than in SQLite")
    db.close()
    connection.close()


def as_rows(table):
    return list(zip(*(column.to_pylist() for column in table.columns), strict=True))


def as_in_sqlite(value):
    """Times and days as the text that SQLite holds."""
    if isinstance(value, datetime.datetime):
        milliseconds = (value - EPOCH) // datetime.timedelta(milliseconds=1)
        return (EPOCH + datetime.timedelta(milliseconds=milliseconds)).isoformat(timespec="milliseconds")[:23] + "Z"
    return value.isoformat() if isinstance(value, datetime.date) else value


def check_questions(database, file):
    connection = connect(database)
    public = set(views_of(connection))
    entries = re.findall(r"^-- ## ([^\n]+)$(.+?;)$", file.read_text(encoding="utf-8"), flags=re.M | re.S)
    if len(entries) < 20:
        wrong("questions", f"{file.name} has {len(entries)} statements only")
    for question, statement in entries:
        own = set(re.findall(r"(\w+) AS (?:(?:NOT )?MATERIALIZED )?\(", statement))
        for table in set(re.findall(r"(?:FROM|JOIN)\s+(\w+)", statement)) - own - public:
            wrong("questions", f'"{question}" reads {table}, which is no view')
        begin = time.perf_counter()
        try:
            connection.execute(statement).fetchall()
        except sqlite3.Error as error:
            wrong("questions", f'"{question}" fails: {error}')
        if (seconds := time.perf_counter() - begin) > SLOWEST_S:
            # a machine may be slow: said, and no fault
            print(f'questions: "{question}" takes {seconds:.2f} s, more than {SLOWEST_S} s')
    connection.close()


def check_python(database, folder, folders):
    """Each script, whose second line of text is its call, with the database or the folder that it reads."""
    import duckdb

    if not load_sqlite_of_duckdb(duckdb):
        return
    given = {"DATABASE": database} | folders
    scripts = sorted(folder.glob("*.py"))
    if len(scripts) < 6:
        wrong("python", f"{folder} has {len(scripts)} scripts only")
    for script in scripts:
        call = re.search(r"^    python3 (\w+\.py) ([A-Z]+)$", script.read_text(encoding="utf-8"), flags=re.M)
        if call is None or call[1] != script.name or call[2] not in given:
            wrong("python", f"{script.name} does not state its call")
        elif given[call[2]]:
            done = subprocess.run([sys.executable, script, given[call[2]]], capture_output=True, text=True)
            if done.returncode or not done.stdout:
                last = (done.stderr.strip().splitlines() or ["it prints nothing"])[-1]
                wrong("python", f"{script.name} fails: {brief(last)}")


def documentation(asked):
    here = pathlib.Path(__file__).resolve().parent
    above = [folder / name for folder in (here, *here.parents) for name in ("docs", "examples")]
    near = [pathlib.Path(asked)] if asked else [here, *above]
    return lambda name: next((folder / name for folder in near if (folder / name).is_file()), None)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("database")
    parser.add_argument("--parquet", help="folder of an export of this database as Parquet")
    parser.add_argument("--history", help="folder of an export of this database as Parquet by month")
    parser.add_argument("--docs", help="folder of schema.md, questions.sql and the scripts")
    parser.add_argument("--tool", action="append", choices=TOOLS, help="only this one; may be repeated")
    arguments = parser.parse_args()
    database = os.path.abspath(arguments.database)
    page = documentation(arguments.docs)
    if not os.path.isfile(database):
        return f"there is no database {database}"
    if page("schema.md") is None:
        return "schema.md is not to be found; name its folder with --docs"
    folders = {"PARQUET": arguments.parquet, "HISTORY": arguments.history}
    for name, folder in folders.items():
        if folder and not os.path.isdir(folder):
            return f"there is no folder {folder}"
        if not folder and name.lower() in (arguments.tool or []):
            return f"name the folder of an export with --{name.lower()}"
    schema = read_schema(page("schema.md"))
    if not schema:
        return f"{page('schema.md')} states no columns"
    for tool in arguments.tool or [tool for tool in TOOLS if folders.get(tool.upper(), "none asked for")]:
        before = len(problems)
        try:
            if tool in ("questions", "python"):
                if (found := page("questions.sql")) is None:
                    wrong(tool, "questions.sql is not to be found; name its folder with --docs")
                elif tool == "questions":
                    check_questions(database, found)
                else:
                    check_python(database, found.parent, folders)
            elif tool.upper() in folders:
                globals()[f"check_{tool}"](database, schema, folders[tool.upper()])
            else:
                globals()[f"check_{tool}"](database, schema)
        except ModuleNotFoundError as error:
            wrong(tool, f"the package {error.name} is missing; install requirements.txt")
        except Exception as error:
            wrong(tool, f"the check ended early: {type(error).__name__}: {brief(error)}")
        print(f"{tool}: {'good' if len(problems) == before else f'{len(problems) - before} wrong'}")
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    outcome = main()
    if isinstance(outcome, str):
        print(outcome, file=sys.stderr)
        outcome = 2
    sys.exit(outcome)
