"""What may differ between two runs of one program, as narrow as possible. Masked everywhere are the path of the scratch
folder, and times within the minutes of the comparison: these tell of the clock."""

import re

# Part, pattern, what takes its place, reason.
TEXTS = [
    ("simulate", r'(?m)^\{.*"event":"alarm".*\n', "", "the daemon of the demo judges a test as soon as it has time"),
    ("simulate", r'(?<="run_id":)\d+', "#", "the daemon of the demo takes files in an order of its own"),
    ("simulate", r'(?<="anomaly_id":)\d+', "#", "the same of the robots that it judges"),
    ("simulate", r'(?<="folder_bytes":)\d+', "#", "size of the demo's folder with what SQLite keeps beside a database"),
    (".*", r"(?m)(?<=; )(\d+ min )?\d+ s$", "#", "time that `ingest` took"),
    (".*", r'(?<="took_s":)[\d.e-]+', "#", "time that a command took"),
    ("reading|broken|tx40", r'(?<="age_s":)[\d.]+', "#", "time since a file was written"),
    (".*", r"(?<=armwatch-)[0-9a-f]{12}(?=-\d)", "#", "random name of the database in keys of messages"),
    ("files", r"(?m)((?:anomaly_history|baseline_changes)\.parquet +\d+) +\d+$", r"\1 #",
     "size of what has times of the clock and is compressed"),
]

# Table, column, reason.
COLUMNS = [
    ("database_identity", "identity", "random"),
    ("run", "inode", "the file's number in the file system"),
    ("run", "device", "the file system's number"),
]

_TEXTS = [(re.compile(part), re.compile(pattern), mask) for part, pattern, mask, _ in TEXTS]
_COLUMNS = {(table, column) for table, column, _ in COLUMNS}


def is_masked(table, column):
    return (table, column) in _COLUMNS


def masked(part, text):
    for of, pattern, mask in _TEXTS:
        if of.fullmatch(part):
            text = pattern.sub(mask, text)
    return text
