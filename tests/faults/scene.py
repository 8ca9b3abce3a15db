"""The scenario: a daemon that watches, ingests, concludes, delivers, archives, takes an upload and writes a snapshot, what
the world around it does meanwhile, and what must hold at the end."""

import collections
import contextlib
import http.client
import http.server
import json
import os
import pathlib
import re
import shutil
import signal
import sqlite3
import subprocess
import threading
import time

PORT, SINK_PORT = 18650, 18651
TOKEN = "a-token-of-this-harness-0123456789"
ROBOT = "A"
# A disturbed daemon that is not done by then, or after so many times the undisturbed scenario, is stopped and started
# again, as an operator would.
PATIENCE_S, PATIENCE_RATIO = 4.0, 4.0
# A daemon without faults that is not done by then has lost something. Takes a second on an idle machine.
LONGEST_S = 120.0
# Statuses of docs/operations.md with which a daemon may end if a call fails.
STATUSES = {0, 74}
# A file of settings that cannot be read is reported as such.
STATUSES_OF_SETTINGS = STATUSES | {2}

# Each is in a folder that the program has to make, so that nothing else happens to sync its name.
SPOOL, ARCHIVE, SNAPSHOT = "spool/line/in", "archive/line/tests", "snapshot/line/armwatch.db"

CONFIG = """
[watch]
folders = ["inbox"]
scan_interval_s = 0.1
settle_s = 0.1
archive = "{archive}"
[serve]
listen = "127.0.0.1:{port}"
token_file = "token"
requests_per_s = 0
[serve.upload]
spool = "{spool}"
[snapshot]
file = "{snapshot}"
interval_min = 0.1
[alerts]
retry_first_s = 0.05
retry_most_s = 0.2
[[alerts.route]]
name = "pager"
severity = "info"
[alerts.route.webhook]
url = "http://127.0.0.1:{sink}/"
[detect]
baseline_runs = 2
[[robot]]
name = "*"
description = "{repository}/config/robots/scara.toml"
layout = "{repository}/config/exports/native.toml"
"""


# Leftovers that a later life removes by their age: copies for readers after a day, a file that tries whether the spool can
# be written to after ten.
STAYS = re.compile(r"snapshot/.*\.partial(-journal)?$|spool/.*/\.partial/probe-")



# Columns that are not compared: times of the machine's clock, numbers given in the order of work, and the byte of a fault,
# which is missing if the file cannot be read once more.
DIFFERING = {
    ("quarantine", "tries"), ("quarantine", "first_at"), ("quarantine", "last_at"), ("quarantine", "retry_asked_at"),
    ("quarantine", "fault_id"), ("quarantine", "byte"), ("anomalies", "anomaly_id"),
}  # fmt: skip
# Views of when the program did something; deliveries and events are compared by key instead.
OF_DEEDS = {"anomaly_history", "baseline_changes", "maintenance_log", "deliveries"}


class Material(collections.namedtuple("Material", "first second growing worn bad")):
    """The exports of the scenario: two that lie there, one that grows, one that is uploaded and raises an alarm, and one
    that is refused. Each is a pair of name and content."""

    @classmethod
    def make(cls, program, repository, folder):
        def simulate(name, cycles):
            target = folder / name
            command = [program, "simulate", "-o", target, "--truth", folder / "truth", "--name", ROBOT, "--seed", "3"]
            command += ["--robot", repository / "config/robots/scara.toml", "--warming-s", "1", "--rate-hz", "20"]
            command += ["--runs", "4", "--cycles", str(cycles), "--fault", "wear:joint=1,from=4,rate=0.6"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            return [(path.name, path.read_bytes()) for path in sorted(target.iterdir())]

        first, second, _, worn = simulate("one", 1)
        return cls(first, second, simulate("two", 2)[2], worn, ("B_20260105_0847.csv", b"time,pos_1\n0,1\n"))

    def stored(self):
        return dict([self.first, self.second, self.growing, self.worn])


def beginning(material, repository):
    """Folders and files before the daemon starts."""
    settings = dict(port=PORT, sink=SINK_PORT, repository=repository, archive=ARCHIVE, spool=SPOOL, snapshot=SNAPSHOT)
    files = {"armwatch.toml": CONFIG.format(**settings).encode(), "token": TOKEN.encode()}
    files |= {f"inbox/{name}": content for name, content in (material.first, material.second, material.bad)}
    name, content = material.growing
    return {"inbox"}, files | {f"inbox/{name}": content[: len(content) // 2]}


class World:
    """What outlasts every end of the daemon: what the client and the receiver of alarms know."""

    def __init__(self):
        self.is_acknowledged = False
        self.messages = []


class Sink:
    """A receiver of alarms that keeps the key and title of each message."""

    def __init__(self):
        sink = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["content-length"])))
                sink.world.messages.append((self.headers["webhook-id"], body["title"]))
                self.send_response(200)
                self.send_header("content-length", "0")
                self.end_headers()

            def log_message(self, *_):
                pass

        self.world = World()
        server = http.server.ThreadingHTTPServer(("127.0.0.1", SINK_PORT), Handler)
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, args=[0.05], daemon=True).start()


class Scene:
    """A folder with the scenario, for one case after the other."""

    def __init__(self, root, program, repository, shim, material):
        self.root, self.program, self.shim, self.material = pathlib.Path(root), program, shim, material
        self.beginning = beginning(material, repository)
        self.sink = Sink()
        self.log = self.root.parent / "log"

    def clear(self):
        for path in self.root.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self.log.unlink(missing_ok=True)
        self.sink.world = World()

    def lay_out(self, state):
        folders, files = state
        self.clear()
        for folder in sorted(folders):
            (self.root / folder).mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            (self.root / path).write_bytes(content)
        os.chmod(self.root / "token", 0o600)

    # --- what the world does

    def grow(self, at_once):
        """The controller writes the rest of the growing export; the archive may have taken it already."""
        name, content = self.material.growing
        path = self.root / "inbox" / name
        pieces = 1 if at_once else 3
        with contextlib.suppress(FileNotFoundError):
            for piece in range(1, pieces + 1):
                size = path.stat().st_size
                end = len(content) // 2 + (len(content) - len(content) // 2) * piece // pieces
                if size < end:
                    with open(path, "r+b") as file:
                        file.seek(size)
                        file.write(content[size:end])
                if piece < pieces:
                    time.sleep(0.04)

    def request(self, method, headers, body=b""):
        connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=5)
        try:
            headers = {"Authorization": f"Bearer {TOKEN}"} | headers
            connection.request(method, f"/v1/exports/{self.material.worn[0]}", body, headers)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}
        finally:
            connection.close()

    def upload(self):
        """The client goes on where the server says, in two parts; done with the answer 200 or 201."""
        content = self.material.worn[1]
        with contextlib.suppress(OSError, http.client.HTTPException):
            status, headers = self.request("HEAD", {})
            offset = int(headers.get("upload-offset", 0)) if status < 300 else 0
            if status == 200 and headers.get("upload-complete", "?0") == "?1":
                offset = 0
            ends = [len(content) // 2, len(content)] if offset < len(content) // 2 else [len(content)]
            for end in ends:
                header = {"Content-Range": f"bytes {offset}-{end - 1}/{len(content)}"}
                if offset == len(content):
                    header = {"Content-Range": f"bytes */{len(content)}"}
                status, _ = self.request("PUT", header, content[offset:end])
                if status in (200, 201):
                    self.sink.world.is_acknowledged = True
                if status not in (200, 201, 202):
                    return status
                offset = end
            return status
        return None

    # --- the daemon

    def start(self, settings):
        environment = {"PATH": os.environ["PATH"], "ARMWATCH_LOG": "warn,armwatch=trace", "TOKIO_WORKER_THREADS": "2"}
        if settings:
            environment |= {"LD_PRELOAD": str(self.shim), "SHIM_ROOT": str(self.root)} | settings
        with open(self.log, "ab") as log:
            command = [self.program, "run"]
            return subprocess.Popen(
                command, cwd=self.root, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log
            )

    def said(self):
        with contextlib.suppress(FileNotFoundError):
            return self.log.read_text(errors="replace")
        return ""

    def live(self, settings, is_first, longest_s):
        """One life of the daemon, stopped once all is done or after some time; its status, and whether all was done."""
        begun, before = time.monotonic(), len(self.said())
        if not is_first:
            self.grow(at_once=True)
        daemon = self.start(settings)
        writer = threading.Thread(target=self.grow, args=[False]) if is_first else None
        try:
            is_done, looks = False, None
            while daemon.poll() is None and time.monotonic() - begun < longest_s:
                time.sleep(0.01)
                said = self.said()[before:]
                if writer and "scanned the watched" in said and not writer.ident:
                    writer.start()
                growing_is_stored = f"inbox/{self.material.growing[0]} robot" in said
                if not self.sink.world.is_acknowledged and (
                    growing_is_stored or not is_first and "serving HTTP" in said
                ):
                    self.upload()
                count = said.count("waiting=0 open=0 to_conclude=0")
                looks = count if looks is None and self.is_complete() else looks
                # the first look may have begun before all was stored
                if looks is not None and count > looks + 1 and self.is_delivered():
                    is_done = True
                    break
            if daemon.poll() is None:
                daemon.send_signal(signal.SIGTERM)
            try:
                return daemon.wait(LONGEST_S), is_done
            except subprocess.TimeoutExpired:
                return "does not stop", is_done
        finally:
            if daemon.poll() is None:
                daemon.kill()
                daemon.wait()
            if writer and writer.ident:
                writer.join()

    def is_complete(self):
        """Whether the files are where they belong."""
        inbox = os.listdir(self.root / "inbox")
        spool = self.root / SPOOL
        uploads = [name for name in os.listdir(spool) if name != ".partial"] if spool.exists() else []
        return self.sink.world.is_acknowledged and inbox == [self.material.bad[0]] and not uploads

    def is_delivered(self):
        with contextlib.suppress(sqlite3.Error), contextlib.closing(self.open("armwatch.db")) as database:
            rows = database.execute("SELECT state, count(*) FROM deliveries GROUP BY state").fetchall()
            return [state for state, _ in rows] == ["sent"]
        return False

    def open(self, name):
        return sqlite3.connect(f"file:{self.root / name}?mode=ro", uri=True, timeout=5)

    def recover(self):
        """A life without faults; what is wrong with it."""
        status, is_done = self.live(None, False, LONGEST_S)
        wrong = [] if is_done else [f"not done after {LONGEST_S:.0f} s without faults"]
        return wrong if status == 0 else [*wrong, f"status {status} without faults"]

    # --- what must hold

    def missing_inputs(self):
        """Exports of which no copy exists that somebody would still take up, at any moment."""
        def contents(folder):
            place = self.root / folder
            return {path.read_bytes() for path in place.iterdir() if path.is_file()} if place.exists() else set()

        archive, inbox, spool = (contents(folder) for folder in (ARCHIVE, "inbox", SPOOL))
        material = self.material
        lost = [name for name, content in (material.first, material.second) if content not in inbox | archive]
        name, content = material.growing
        if content not in archive and not (self.root / "inbox" / name).exists():
            lost.append(name)
        if self.sink.world.is_acknowledged and material.worn[1] not in spool | archive:
            lost.append(material.worn[0])
        return [f"{name} is lost" for name in lost]

    def check(self, reference=None):
        """What is wrong at the end, and the rows of all views."""
        wrong = self.check_files()
        dumps = {}
        for name in ("armwatch.db", SNAPSHOT):
            try:
                with contextlib.closing(self.open(name)) as database:
                    for check in ("integrity_check", "foreign_key_check"):
                        found = database.execute(f"PRAGMA {check}").fetchall()
                        wrong += [f"{name}: {check}: {found[:3]}"] if found not in ([("ok",)], []) else []
                    dumps[name] = dump(database)
                    if name == "armwatch.db":
                        wrong += self.check_messages(database)
            except sqlite3.Error as error:
                wrong.append(f"{name}: {error}")
        for name, found in dumps.items():
            wrong += [f"{name}: {what}" for what in differences(found, reference or dumps.get("armwatch.db"))]
        said = self.said()
        wrong += [f"the log says: {line}" for line in said.splitlines() if "panicked" in line]
        return wrong, dumps.get("armwatch.db")

    def check_files(self):
        wrong = []
        material = self.material
        places = [(ARCHIVE, material.stored()), ("inbox", dict([material.bad])), (SPOOL, {})]
        for folder, wanted in places:
            place = self.root / folder
            found = {path.name: path.read_bytes() for path in place.iterdir() if path.is_file()} if place.exists() else {}
            for name in found.keys() | wanted.keys():
                if found.get(name) != wanted.get(name):
                    what = "missing" if name not in found else "left over" if name not in wanted else "changed"
                    wrong.append(f"{folder}/{name} is {what}")
        return wrong + [f"{path} is left over" for path in self.leftovers() if not STAYS.match(path)]

    def leftovers(self):
        """Files that an ended process needed for a moment only."""
        paths = [str(path.relative_to(self.root)) for path in self.root.rglob("*") if path.is_file()]
        return [path for path in paths if ".partial" in path or path.endswith(("-wal", "-journal"))]

    def check_messages(self, database):
        """Every event was told at least once, under one key that tells one thing."""
        events = [number for (number,) in database.execute("SELECT anomaly_event_id FROM anomaly_history")]
        titles = collections.defaultdict(set)
        for key, title in self.sink.world.messages:
            titles[key].add(title)
        told = {int(key.rsplit("-", 1)[1]) for key in titles}
        wrong = [f"key {key} told {sorted(said)}" for key, said in titles.items() if len(said) > 1]
        wrong += [f"messages of {len(told)} events, {len(events)} events"] if told != set(events) else []
        stems = {key.rsplit("-", 1)[0] for key in titles}
        wrong += [f"keys of {len(stems)} databases"] if len(stems) != 1 else []
        pending = database.execute("SELECT count(*) FROM deliveries WHERE state <> 'sent'").fetchone()[0]
        return wrong + ([f"{pending} messages are not sent"] if pending else [])


def dump(database):
    """Every row of every view, by view. Runs are named by their export, since their numbers follow the order of work."""
    database.execute("PRAGMA temp_store = MEMORY")
    runs = "(SELECT robot || ' ' || source_name || ' ' || ifnull(content_hash, '') FROM runs WHERE run_id = seen.{})"
    query = "SELECT name FROM sqlite_schema WHERE type = 'view' ORDER BY name"
    views = {}
    for (view,) in database.execute(query).fetchall():
        if view in OF_DEEDS:
            continue
        columns = [column for (column,) in database.execute("SELECT name FROM pragma_table_info(?)", [view])]
        cells = [
            runs.format(column) if column.endswith("run_id") else f'quote(seen."{column}")'
            for column in columns
            if (view, column) not in DIFFERING
        ]
        rows = database.execute(f'SELECT {", ".join(cells)} FROM "{view}" AS seen').fetchall()
        views[view] = sorted(map(repr, rows))
    return views


def differences(found, wanted):
    wrong = []
    for view in sorted(wanted.keys() | found.keys()):
        have, want = found.get(view, []), wanted.get(view, [])
        if have != want:
            extra, missing = [row for row in have if row not in want], [row for row in want if row not in have]
            wrong.append(f"{view} has {len(have)} rows of {len(want)}; found {extra[:1]}, wanted {missing[:1]}")
    return [f"{len(wrong)} views differ, the first: {wrong[0]}"] if wrong else []


def event_positions(entries):
    """Numbers of the calls that told the client of its upload, and that sent each alarm, with key and title."""
    acknowledged, messages = None, []
    for number, entry in enumerate(entries, 1):
        if entry.call != "send":
            continue
        if entry.data.startswith((b"HTTP/1.1 201", b"HTTP/1.1 200")) and b'"new"' in entry.data:
            acknowledged = acknowledged or number
        key = re.search(rb"(?i)webhook-id: (\S+)\r\n", entry.data)
        if key:
            messages.append([number, key[1].decode(), None])
        title = re.search(rb'"title":"((?:[^"\\]|\\.)*)"', entry.data)
        if title and messages:
            messages[-1][0], messages[-1][2] = number, json.loads(b'"' + title[1] + b'"')
    return acknowledged, messages
