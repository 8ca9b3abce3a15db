"""A disk in memory that replays the calls of a trace and gives what a kill or a loss of power after any of them leaves.

The rules are those of POSIX and no stricter file system: data lasts once its file is synced, a name once the folder that
holds it is synced. A rename is one step, as on every file system with a journal.
"""

import collections
import hashlib
import os
import pathlib
import random
import struct

CALLS = ("open", "read", "write", "sync", "truncate", "rename", "remove", "mkdir", "link", "list", "send")
ENTRY = struct.Struct("=BBBBiQqIIII")
# Sectors are written whole or not at all.
SECTOR_BYTES = 512

Entry = collections.namedtuple("Entry", "call creates lies result inode offset path other place data")


def read_trace(path):
    """All calls of a trace, in their order."""
    content, at, entries = pathlib.Path(path).read_bytes(), 0, []
    while at < len(content):
        call, creates, lies, _, result, inode, offset, *lengths = ENTRY.unpack_from(content, at)
        at += ENTRY.size
        parts = []
        for length in lengths:
            parts.append(content[at : at + length])
            at += length
        path, other, place = (part.decode().rstrip("/") for part in parts[:3])
        entries.append(Entry(CALLS[call], creates, lies, result, inode, offset, path, other, place, parts[3]))
    return entries


class File:
    """Content as the program sees it, as it was at the last sync, and the changes since."""

    def __init__(self, content=b"", synced=None):
        self.content = bytearray(content)
        self.synced = synced
        self.changes = []
        self.now = None

    def change(self, change):
        self.changes.append(change)
        self.now = None
        apply_change(self.content, change)

    def sync(self):
        self.synced, self.changes = self.after_kill(), []

    def after_kill(self):
        """The content; the same object until the next change."""
        if self.now is None:
            self.now = bytes(self.content)
        return self.now


def apply_change(content, change):
    offset, data = change
    if data is None:
        del content[offset:]
        content.extend(bytes(offset - len(content)))
        return
    content.extend(bytes(max(0, offset - len(content))))
    content[offset : offset + len(data)] = data


class Names:
    """Folders, and files by path."""

    def __init__(self, files=(), folders=()):
        self.files, self.folders = dict(files), set(folders)

    def apply(self, step):
        kind, path, what = step
        if kind == "file":
            self.files[path] = what
        elif kind == "folder":
            self.folders.add(path)
        elif kind == "remove":
            self.files.pop(path, None)
            self.folders.discard(path)
        else:
            self.files.pop(path, None)
            target, file = what
            self.files[target] = file

    def content(self, content_of):
        """Content of each file whose folders all exist."""
        def is_there(path):
            folder = os.path.dirname(path)
            return not folder or folder in self.folders and is_there(folder)

        return {path: content_of(file) for path, file in sorted(self.files.items()) if is_there(path)}


def parents(step):
    kind, path, what = step
    return {os.path.dirname(path)} | ({os.path.dirname(what[0])} if kind == "rename" else set())


def touched(step):
    kind, path, what = step
    return {path} | ({what[0]} if kind == "rename" else set())


class Disk:
    """The folder of a scenario; begins with what lay there before the program started, all of it synced."""

    def __init__(self, files, folders):
        files = {path: File(content, content) for path, content in files.items()}
        self.now, self.synced = Names(files, folders), Names(files, folders)
        self.steps = []
        self.by_inode = {}

    def step(self, *step):
        self.now.apply(step)
        self.steps.append(step)

    def file(self, entry):
        file = self.now.files.get(entry.path)
        return self.by_inode.setdefault(entry.inode, file)

    def apply(self, entry):
        """Carries out a call; whether it changed anything."""
        call = entry.call
        if entry.result < 0 or entry.place == "index":
            return False
        if call == "open" and entry.creates:
            self.by_inode[entry.inode] = File()
            self.step("file", entry.path, self.by_inode[entry.inode])
        elif call == "open":
            if entry.path in self.now.files:
                self.by_inode[entry.inode] = self.now.files[entry.path]
            if not entry.offset or entry.path not in self.now.files:
                return False
            self.file(entry).change((0, None))
        elif call == "write" and self.file(entry):
            self.file(entry).change((entry.offset, entry.data))
        elif call == "truncate" and self.file(entry):
            self.file(entry).change((entry.offset, None))
        elif call == "sync" and not entry.lies:
            if entry.path == "" or entry.path in self.now.folders:
                self.sync_folder(entry.path)
            elif self.file(entry):
                self.file(entry).sync()
        elif call == "rename":
            self.step("rename", entry.path, (entry.other, self.now.files[entry.path]))
        elif call == "remove":
            self.step("remove", entry.path, None)
        elif call == "mkdir":
            self.step("folder", entry.path, None)
        elif call == "link":
            self.step("file", entry.other, self.now.files[entry.path])
        else:
            return False
        return True

    def sync_folder(self, folder):
        """Makes the names in a folder last, with the earlier steps that they presuppose."""
        paths, due, rest = set(), [], []
        for step in reversed(self.steps):
            is_due = folder in parents(step) or paths & touched(step)
            if is_due:
                paths |= touched(step)
            (due if is_due else rest).append(step)
        for step in reversed(due):
            self.synced.apply(step)
        self.steps = rest[::-1]

    def after_kill(self):
        """The kernel has everything that the program gave it."""
        return self.now.folders, self.now.content(File.after_kill)

    def after_power_cut(self, keeps, seed):
        """Nothing that was not synced ("nothing"), all names without data ("names"), or a random part ("some"): the first
        names, any writes, cut at any sector."""
        draw = random.Random(seed)
        names = Names(self.synced.files, self.synced.folders)
        kept = {"nothing": 0, "names": len(self.steps)}.get(keeps, draw.randint(0, len(self.steps)))
        for step in self.steps[:kept]:
            names.apply(step)

        def content(file):
            if keeps != "some":
                return file.synced or b""
            content = bytearray(file.synced or b"")
            for offset, data in file.changes:
                fate = draw.random()
                if fate < 0.2 and data:
                    data = data[: draw.randint(0, len(data) // SECTOR_BYTES) * SECTOR_BYTES]
                if fate < 0.6:
                    apply_change(content, (offset, data))
            return bytes(content)

        return names.folders, names.content(content)


def digest(state, known):
    """A hash of a state. `known` keeps those of contents, few of which change from call to call."""
    folders, files = state
    whole = hashlib.blake2b(repr(sorted(folders)).encode())
    for path, content in files.items():
        if id(content) not in known or known[id(content)][0] is not content:
            known[id(content)] = content, hashlib.blake2b(content).digest()
        whole.update(path.encode() + b"\0" + known[id(content)][1])
    return whole.hexdigest()
