"""Where two outputs differ, in lines that people read."""

import difflib
import hashlib
import os
import re

# Lines of a difference that are shown, and characters of each.
SHOWN, WIDTH = 24, 200
# Above so many lines between the first and the last difference, all of them are taken as changed.
COMPARED = 3000


class Pattern:
    """A line `part: regex` of the file of announced differences."""

    def __init__(self, line):
        self.line, self.used = line, False
        self.part, _, regex = (word.strip() for word in line.partition(":"))
        self.regex = re.compile(regex)


class Difference:
    """An output that differs: its part and name, and lines of which those with - and + are changes."""

    def __init__(self, part, what, old, new):
        self.part, self.what = part, what
        self.is_in_bytes = isinstance(old, bytes) and isinstance(new, bytes)
        self.lines = list(changes(shown_lines(old), shown_lines(new)))

    def is_expected(self, patterns):
        """Whether an announced pattern has the name, or each change has one; these are marked as used."""
        own = [pattern for pattern in patterns if pattern.part in (self.part, "*")]
        changed = [line[2:] for line in self.lines if line[0] in "-+"]
        fitting = [pattern for pattern in own if pattern.regex.search(self.what)]
        if not fitting:
            of_lines = [[pattern for pattern in own if pattern.regex.search(line)] for line in changed]
            fitting = sum(of_lines, []) if all(of_lines) else []
        for pattern in fitting:
            pattern.used = True
        return bool(fitting)

    def __str__(self):
        lines = [line[:WIDTH] + " .." * (len(line) > WIDTH) for line in self.lines[:SHOWN]]
        if len(self.lines) > SHOWN:
            lines.append(f".. {len(self.lines) - SHOWN} more lines")
        return "\n    ".join([f"{self.part}: {self.what}", *lines]) + "\n"


def differences(old, new):
    """Differences of the outputs of two sides, by part and name, in the order in which they were made."""
    keys = [key for key in dict.fromkeys([*old, *new]) if old.get(key) != new.get(key)]
    return [Difference(*key, old.get(key), new.get(key)) for key in keys]


def shown_lines(content):
    if content is None:
        return ["(is not there)"]
    try:
        return (content.decode() if isinstance(content, bytes) else content).split("\n")
    except UnicodeDecodeError:
        return [f"{len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}"]


def changes(old, new):
    """Lines without the equal ones at both ends, as changes."""
    head = next((i for i, (a, b) in enumerate(zip(old, new)) if a != b), min(len(old), len(new)))
    old, new = old[head:], new[head:]
    tail = next((i for i, (a, b) in enumerate(zip(old[::-1], new[::-1])) if a != b), min(len(old), len(new)))
    old, new = old[:len(old) - tail], new[:len(new) - tail]
    if len(old) + len(new) > COMPARED:
        blocks = [("replace", 0, len(old), 0, len(new))]
    else:
        blocks = difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
    for kind, i, j, k, m in blocks:
        if kind == "equal":
            continue
        yield f"@@ line {head + i + 1} @@"
        if j - i == m - k:
            for a, b in zip(old[i:j], new[k:m]):
                yield from changed_pieces(a, b)
        else:
            yield from (f"- {line}" for line in old[i:j])
            yield from (f"+ {line}" for line in new[k:m])


def changed_pieces(old, new):
    """A changed line; of a wide one, such as JSON, SVG or a row, its beginning and the pieces that differ."""
    a, b = (re.split(r"(?<=[,>}|])", line) for line in (old, new))
    if len(a) == len(b) and max(len(old), len(new)) > WIDTH // 2:
        yield f"  {old[:WIDTH // 2]}"
        pairs = [pair for pair in zip(a, b) if pair[0] != pair[1]]
    else:
        # from shortly before the first character that differs
        begin = max(len(os.path.commonprefix([old, new])) - WIDTH // 2, 0)
        pairs = [(".. " * (begin > 0) + old[begin:], ".. " * (begin > 0) + new[begin:])]
    for a, b in pairs:
        yield f"- {a}"
        yield f"+ {b}"
