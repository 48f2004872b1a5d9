"""Bags of sqlite3: what a database may hold beside messages, and what is never done with it."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE
from gyrowheel_recording.bags import Recording

from .recordings import assert_counting, foreign, measurements

_TOPICS = """
CREATE TABLE topics(
    id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT
);
INSERT INTO topics VALUES (1, '/gyrowheel/measurement', 'gyrowheel_msgs/msg/Measurement', 'cdr', '');
"""
_MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"


def database(file: Path, text: str) -> Path:
    connection = sqlite3.connect(file)
    connection.executescript(text)
    connection.commit()
    connection.close()
    return file


def counted(path: Path) -> Path:
    return foreign(path, list(enumerate(measurements())), plugin=StoragePlugin.SQLITE3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            f"""{_TOPICS}
            CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c)
            SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(100000) AS data FROM c;""",
            "its 'messages' is a view; allowed in a recording: tables",
        ),
        (
            f"""{_TOPICS}
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
                                  data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)) VIRTUAL);
            INSERT INTO messages(topic_id, timestamp) VALUES (1, 1);""",
            "column 'data' of its table 'messages' is computed",
        ),
        (
            f"{_TOPICS}{_MESSAGES} CREATE INDEX i ON messages(length(hex(zeroblob(20000000 + id))) * 0);",
            "its index 'i' is computed; allowed in a recording: those of columns",
        ),
        (
            f"{_TOPICS}{_MESSAGES} CREATE INDEX i ON messages(id) WHERE length(hex(zeroblob(id))) > 0;",
            "its index 'i' is computed",
        ),
        (
            f"{_TOPICS}{_MESSAGES} INSERT INTO messages VALUES (1, 1, 1, 1000000000000);",
            "damaged: a message that is no bytes",
        ),
        (
            f"{_TOPICS}{_MESSAGES} INSERT INTO messages VALUES (1, 1, 'soon', x'00');",
            "damaged: the time of a message is no whole number",
        ),
        (
            f"{_TOPICS}{_MESSAGES} INSERT INTO messages VALUES (1, 7, 1, x'00');",
            "damaged: messages of topic 7, which is not declared",
        ),
        (_TOPICS, "not a recording: it has no table 'messages'"),
        (
            f"{_TOPICS} CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, data BLOB);",
            "its table 'messages' has no column 'timestamp'",
        ),
    ],
    ids=[
        "view",
        "computed",
        "index of an expression",
        "partial index",
        "a number",
        "no time",
        "no topic",
        "no table",
        "no column",
    ],
)
def test_database_without_message_tables_is_refused(text: str, said: str, tmp_path: Path) -> None:
    file = database(tmp_path / "a.db3", text)
    with pytest.raises(InputError) as refused:
        Recording.open(file)
    assert str(refused.value).startswith(f"{file}: {said}")


@pytest.mark.parametrize("name", ["50%3F", "a?mode=memory", "b#c", " d&e=f "])
def test_a_path_with_uri_characters_is_read(name: str, tmp_path: Path) -> None:
    """It is the file that is read."""
    assert_counting(Recording.open(counted(tmp_path / "bag").rename(tmp_path / name)))


def test_reading_a_database_creates_no_file(tmp_path: Path) -> None:
    """Also beside one that keeps a log, of which nothing is left."""
    path = counted(tmp_path / "bag")
    file = next(path.glob("*.db3"))
    connection = sqlite3.connect(file)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.close()
    assert file.read_bytes()[18:20] == b"\2\2"
    before = sorted(path.iterdir())
    assert_counting(Recording.open(path))
    assert sorted(path.iterdir()) == before


def compressed(path: Path) -> Path:
    """Write a database that is compressed as a whole; return its folder."""
    rows = list(enumerate(measurements()))
    return foreign(path, rows, plugin=StoragePlugin.SQLITE3, compression=CompressionMode.FILE)


def test_log_of_an_unclosed_database_is_read(tmp_path: Path) -> None:
    path = foreign(tmp_path / "bag", list(enumerate(measurements(40))), plugin=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    connection = sqlite3.connect(file)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA wal_autocheckpoint = 0")
    for k, data in enumerate(measurements(10, start=40)):
        connection.execute(
            "INSERT INTO messages(topic_id, timestamp, data) SELECT id, ?, ? FROM topics", (40 + k, data)
        )
    connection.commit()
    assert_counting(Recording.open(file))
    connection.close()


def test_a_database_with_a_log_that_is_compressed(tmp_path: Path) -> None:
    path = compressed(tmp_path / "bag")
    (file,) = path.glob("*.zstd")
    content = bytearray(zstandard.decompress(file.read_bytes(), max_output_size=1 << 24))
    content[18:20] = b"\2\2"
    file.write_bytes(zstandard.compress(bytes(content)))
    assert_counting(Recording.open(path))


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_messages_that_unpack_without_end(
    plugin: StoragePlugin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each may be small: what they grow to together counts."""
    messages = [(k, bytes(4_000_000)) for k in range(4)]
    path = foreign(tmp_path / "bag", messages, plugin=plugin, compression=CompressionMode.MESSAGE)
    assert sum(file.stat().st_size for file in path.iterdir()) < 100_000
    monkeypatch.setenv(LARGEST_VARIABLE, "0.01")
    with pytest.raises(InputError, match=rf"GB of memory; allowed: 0\.01 GB \({LARGEST_VARIABLE} raises"):
        Recording.open(path)


def test_a_database_that_unpacks_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is refused after a part of it, and nothing is written to the disk."""
    path = compressed(tmp_path / "bag")
    (file,) = path.glob("*.zstd")
    file.write_bytes(zstandard.compress(bytes(20_000_000)))
    monkeypatch.setattr("tempfile.tempdir", "/proc/no/such/place")
    monkeypatch.setenv(LARGEST_VARIABLE, "0.01")
    with pytest.raises(InputError, match=rf"{file.name}: unpacked it needs more than 0\.01 GB of memory"):
        Recording.open(path)
