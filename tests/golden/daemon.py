"""The daemon of a part, and what it answers."""

import contextlib
import json
import re
import signal
import socket
import sqlite3
import time
from http.client import HTTPConnection

TOKEN = "golden-golden-golden"


class Daemon:
    """`armwatch run` with the configuration of the part, on a port of its own."""

    def __init__(self, side, database):
        self.binary, self.root, self.database = side.binary, side.root, side.root / database
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        config = side.root / side.environment["ARMWATCH_CONFIG"]
        config.write_text(config.read_text().replace(":8650", f":{self.port}"))
        (side.root / "token").write_text(TOKEN + "\n")
        self.process = side.start(["run", "-qq"])
        self.wait(lambda: self.ask("GET", "/ready")[0] == 200)

    def ask(self, method, path, body=None, kind=None, with_token=True):
        """Status, headers and body of an answer; status 0 while nobody listens."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=60)
        headers = {"Host": "localhost"} | ({"Content-Type": kind} if kind else {})
        if with_token:
            headers["Authorization"] = f"Bearer {TOKEN}"
        try:
            # a refusal may come before all is sent
            with contextlib.suppress(BrokenPipeError):
                connection.request(method, path, body, headers)
            answer = connection.getresponse()
            heads = [f"{name}: {value}\n" for name, value in answer.getheaders() if name.lower() != "date"]
            return answer.status, "".join(sorted(heads)), answer.read()
        except ConnectionRefusedError:
            return 0, "", b""
        finally:
            connection.close()

    def answer(self, line):
        """What is answered to a line METHOD[_WITHOUT_TOKEN] PATH [TYPE BODY | FILE]."""
        method, path, *sent = line.split(" ", 3)
        method, _, without = method.partition("_")
        kind, body = sent if len(sent) == 2 else (None, (self.root / sent[0]).read_bytes() if sent else None)
        if path == "/metrics":
            self.wait(self.is_quiet)
        status, heads, content = self.ask(method, path, body, kind, not without)
        if method == "PUT" and status == 201:
            self.wait(lambda: b'"complete"' in self.ask("GET", path)[2])
        if path == "/metrics" and status == 200:
            heads, content = "", metric_names(content)
        if path == "/v1/openapi.json":
            content = json.dumps(json.loads(content), indent=1).encode()
        return (f"status {status}\n{heads}\n".encode() + content).replace(b":%d" % self.port, b":PORT")

    def wait(self, is_so):
        end = time.time() + 60
        while not is_so():
            if time.time() > end or self.process.poll() is not None:
                self.process.kill()
                raise RuntimeError(f"{self.binary}: the daemon does not come to what is waited for")
            time.sleep(0.1)

    def is_quiet(self):
        """Whether all messages about alarms are sent."""
        connection = sqlite3.connect(f"file:{self.database}?mode=ro", uri=True, timeout=10)
        (waiting,) = connection.execute("SELECT count(*) FROM deliveries WHERE sent_at IS NULL").fetchone()
        connection.close()
        return waiting == 0

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        out, err = self.process.communicate(timeout=60)
        return b"exit status %d\n%s\n%s" % (self.process.returncode, out, err)


def metric_names(content):
    """What is said of metrics, their names and their labels; values tell of the machine."""
    lines = content.decode().splitlines()
    return "\n".join(sorted({line if line[0] == "#" else re.sub(r" \S+$", "", line) for line in lines})).encode()
