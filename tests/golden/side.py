"""One of the two programs in a scratch folder of its own, what it is told to do there, and what it says."""

import hashlib
import os
import re
import shlex
import shutil
import sqlite3
import subprocess
import time
from datetime import datetime, timezone
from pathlib import Path

try:
    from pyarrow import parquet
except ImportError:
    parquet = None

import masks
from daemon import Daemon

GOLDEN = Path(__file__).resolve().parent
REPOSITORY = GOLDEN.parents[1]
# Folders of the repository that the programs read; each side has a copy.
COPIED = ("config", "dashboards", "tests/fixtures", "tests/reference")
# Time of change of every input: without a date in its name, it gives the start of an export.
MODIFIED = 1_767_600_000
LONGEST_S = 300
TIME = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?")


class Side:
    """Works through parts and keeps outputs, files and tables as items, by part and name."""

    def __init__(self, name, binary, folder):
        self.binary, self.root, self.began = binary, folder / name, time.time()
        self.items, self.failures, self.daemon = {}, [], None
        help_of_demo = subprocess.run([binary, "demo", "--help"], capture_output=True, check=False).stdout
        self.takes_first_day = b"--first-day" in help_of_demo
        for place in COPIED:
            shutil.copytree(REPOSITORY / place, self.root / place)
        shutil.copytree(GOLDEN / "configs", self.root / "configs")
        for place in ("home", "tmp", "http", "broken", "with_layout"):
            (self.root / place).mkdir()
        self.environment = {
            "PATH": os.environ["PATH"], "HOME": str(self.root / "home"), "TMPDIR": str(self.root / "tmp"),
            "USER": "golden", "LOGNAME": "golden", "LANG": "C.UTF-8", "TZ": "UTC", "NO_COLOR": "1"}
        # exports of one robot and start would replace each other
        for number, path in enumerate(self.found("tests/fixtures/exports/*.csv")):
            name = f"R{number % 7:02}_20260105_{8 + number // 60:02}{number % 60:02}_{Path(path).name}"
            shutil.copy(self.root / path, self.root / "broken" / name)
        for path in self.found("config/exports/*.toml") + self.found("tests/fixtures/configs/layouts/*.toml"):
            entry = f'[[robot]]\nname = "*"\ndescription = "../config/robots/er3a.toml"\nlayout = "../{path}"\n'
            (self.root / "with_layout" / Path(path).name).write_text(entry)
        er3a = (self.root / "config/robots/er3a.toml").read_text()
        with_gains = er3a.replace("\n[[joint]]\n", "\n[[joint]]\ndrive_gain_nm_a = 12.5\n")
        (self.root / "configs/er3a_with_gains.toml").write_text(with_gains)
        self.date_inputs()

    def date_inputs(self):
        for path in self.root.rglob("*"):
            os.utime(path, (MODIFIED, MODIFIED))

    def found(self, pattern):
        return sorted(str(path.relative_to(self.root)) for path in self.root.glob(pattern))

    def start(self, arguments, **pipes):
        # the dates of the demo would be those of today
        if arguments[:1] == ["demo"] and self.takes_first_day:
            arguments = [*arguments, "--first-day", "2026-01-05"]
        # under one name, as usage texts show it
        return subprocess.Popen(["armwatch", *arguments], executable=self.binary, cwd=self.root, env=self.environment,
                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **pipes)

    def end(self):
        """Ends what an error has left at work."""
        if self.daemon:
            self.daemon.process.kill()

    def work_through(self, part):
        """Does what the lines of a part say; README.md explains them."""
        self.environment.pop("ARMWATCH_CONFIG", None)
        as_json = False
        for line in part.lines:
            word, _, rest = line.partition(" ")
            match word:
                case "@config":
                    self.environment["ARMWATCH_CONFIG"] = rest
                case "@json" | "@text":
                    as_json = word == "@json"
                case "@rows":
                    self.keep_database(part.name, rest)
                case "@copy":
                    source, target = (sqlite3.connect(self.root / name) for name in rest.split())
                    source.backup(target)
                    source.close(), target.close()
                case "@help":
                    self.keep_help(part.name, "")
                case "@each":
                    pattern, _, command = rest.partition(" ")
                    for path in self.found(pattern):
                        self.say(part.name, command.format(path), as_json)
                case "@unordered":
                    self.say(part.name, rest, ordered=False)
                case "@daemon":
                    self.daemon = Daemon(self, rest)
                case "@end":
                    self.keep(part.name, "end of the daemon", self.daemon.end())
                    self.daemon = None
                case _ if self.daemon:
                    self.keep(part.name, line, self.daemon.answer(line))
                case _:
                    self.say(part.name, line, as_json)

    def say(self, part, line, as_json=False, ordered=True):
        """Keeps exit status and output of a command, perhaps of the same with --json too, and the files behind =>."""
        line, _, made = line.partition(" => ")
        for arguments in [shlex.split(line), *([shlex.split(f"{line} --json")] if as_json else [])]:
            process = self.start(arguments)
            try:
                out, err = process.communicate(timeout=LONGEST_S)
            except subprocess.TimeoutExpired:
                process.kill()
                out, err = process.communicate()
            if not ordered:
                # by what is left of each line, as it may differ from one time to the next
                out = "\n".join(sorted(masks.masked(part, out.decode(errors="replace")).split("\n"))).encode()
            config = self.environment.get("ARMWATCH_CONFIG")
            status, command = process.returncode, shlex.join(["armwatch", *arguments]) + f" ({config})" * bool(config)
            said = b"exit status %d\n== standard output\n%s\n== standard error\n%s" % (status, out, err)
            self.keep(part, command, said)
            unusual = status == 0 if part == "wrong" else status not in (0, 1)
            if unusual and part not in ("config", "broken"):
                self.failures.append(f"{part}: {command}: exit status {status}: {err.decode(errors='replace')[:300]}")
        for place in made.split():
            below = sorted(file for file in (self.root / place).rglob("*") if file.is_file())
            for file in below or [self.root / place]:
                self.keep_file(part, file)
        return out.decode(errors="replace")

    def keep_file(self, part, file):
        what = f"file {file.relative_to(self.root)}"
        if not file.exists():
            self.keep(part, what, b"(is not there)")
        elif file.suffix == ".parquet" and parquet:
            self.keep(part, what, parquet_text(file).encode())
        elif part == "simulate":
            # large, and nothing in it is masked
            self.items[part, what] = file.read_bytes()
        else:
            self.keep(part, what, file.read_bytes())

    def keep_help(self, part, command):
        """Help of a command, and of the commands below it, which are indented in it."""
        self.say(part, f"{command} -h")
        text = self.say(part, f"{command} --help").partition("\nOptions:")[0]
        if "<COMMAND>" in text:
            for name in dict.fromkeys(re.findall(r"^  ([a-z][a-z-]+)  +\S", text, re.M)):
                if name != "help":
                    self.keep_help(part, f"{command} {name}")

    def keep_database(self, part, database):
        """Every view and table, a line a row, and what the schema says of each."""
        if not (self.root / database).exists():
            return self.keep(part, database, b"(is not there)")
        connection = sqlite3.connect(f"file:{self.root / database}?mode=ro", uri=True)
        schema = connection.execute("SELECT type, name, ifnull(sql, '') FROM sqlite_schema ORDER BY type, name")
        for kind, name, sql in schema.fetchall():
            self.keep(part, f"{database}: schema of {kind} {name}", sql.encode())
            if kind in ("view", "table"):
                found = connection.execute(f'SELECT * FROM "{name}"')
                columns = [column[0] for column in found.description]
                shown = [not masks.is_masked(name, column) for column in columns]
                cells = ([self.cell(value) if show else "#" for value, show in zip(row, shown)] for row in found)
                rows = sorted(row_text(columns, row) for row in cells)
                self.keep(part, f"{database}: {kind} {name}", "\n".join([" | ".join(columns), *rows]).encode())
        connection.close()

    def cell(self, value):
        if isinstance(value, bytes):
            return f"{len(value)} bytes {hashlib.sha256(value).hexdigest()[:12]}"
        is_clock = isinstance(value, int) and self.began * 1e6 <= value <= time.time() * 1e6
        return "#" if is_clock else repr(value)

    def keep(self, part, what, content):
        """Keeps a text without what tells of this folder, of the clock, and of what else is masked; else the bytes."""
        try:
            text = TIME.sub(self.unless_now, content.decode().replace(str(self.root), "/scratch"))
            content = masks.masked(part, text)
        except UnicodeDecodeError:
            pass
        while (part, what) in self.items:
            # of the same command at two times, such as before and after a change
            what += ", again"
        self.items[part, what] = content

    def unless_now(self, found):
        """A time as it is, but with # for digits if it lies in the minutes of this comparison."""
        try:
            at = datetime.fromisoformat(found[0][:19]).replace(tzinfo=timezone.utc).timestamp()
        except ValueError:
            return found[0]
        is_now = self.began - 60 <= at <= time.time()
        return re.sub(r"\d", "#", found[0][:19]) + ".###" * ("." in found[0]) if is_now else found[0]


def row_text(columns, cells):
    return " | ".join(f"{column}={cell}" for column, cell in zip(columns, cells))


def parquet_text(file):
    table = parquet.read_table(file)
    rows = [row_text(row, map(str, row.values())) for row in table.to_pylist()]
    return "\n".join([str(table.schema), *sorted(rows)])
