"""Files that claim more than they hold, or hold more than any: a small one never takes the memory."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import mcap.writer
import pytest
import zstandard
from rosbags.rosbag2 import CompressionMode

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE
from gyrowheel_recording.bags import Recording, RecordingWriter, salvage
from gyrowheel_recording.bags.mcap import MAGIC, RECORD_HEAD, Op, survey
from tests.recording.recordings import foreign, measurements, record


def a_record(opcode: int, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return RECORD_HEAD.pack(opcode, len(body)) + body


def a_text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


_BEGIN = MAGIC + a_record(Op.HEADER, a_text("ros2"), a_text("anybody"))
_DATA_END = a_record(Op.DATA_END, bytes(4))


def the_end(summary: int = 0) -> bytes:
    return a_record(Op.FOOTER, struct.pack("<QQI", summary, 0, 0)) + MAGIC


def a_chunk(records: bytes) -> bytes:
    stored = zstandard.compress(records)
    head = struct.pack("<QQQI", 0, 0, len(records), zlib.crc32(records))
    return a_record(Op.CHUNK, head, a_text("zstd"), struct.pack("<Q", len(stored)), stored)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("records", "said"),
    [
        (bytes(20_000_000), "claims 20000000 bytes in "),
        (bytes(9_000), "no record at byte 0 of the chunk at byte "),
        (a_record(Op.SCHEMA, bytes(14)) * 140_000, "declares more than there are numbers for"),
    ],
    ids=["nothing", "no records", "declarations"],
)
def test_chunk_with_implausible_uncompressed_content_is_refused(
    records: bytes, said: str, tmp_path: Path
) -> None:
    """Some kilobytes become a list of millions, if they are believed; neither reading nor salvage does."""
    file = tmp_path / "a.mcap"
    file.write_bytes(_BEGIN + a_chunk(records) + _DATA_END + the_end())
    assert file.stat().st_size < 100_000
    with pytest.raises(InputError) as refused:
        Recording.open(file)
    assert said in str(refused.value)
    with pytest.raises(InputError, match="holds no message that can be saved"):
        salvage(file, tmp_path / "saved")


def sparse(file: Path, begin: bytes, size: int, end: bytes) -> Path:
    """Write a file with a hole in it, which takes no room on the disk."""
    with file.open("wb") as stream:
        stream.write(begin)
        stream.truncate(len(begin) + size)
        stream.seek(0, os.SEEK_END)
        stream.write(end)
    return file


@pytest.mark.parametrize(
    ("begin", "end", "said"),
    [
        (_BEGIN + RECORD_HEAD.pack(0x80, 30_000_000), _DATA_END + the_end(), "what belongs together at byte"),
        (_BEGIN + _DATA_END, the_end(len(_BEGIN + _DATA_END)), "its summary"),
    ],
    ids=["record", "summary"],
)
def test_sparse_record_or_summary_beyond_the_memory_limit_is_refused(
    begin: bytes, end: bytes, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = sparse(tmp_path / "a.mcap", begin, 30_000_000, end)
    monkeypatch.setenv(LARGEST_VARIABLE, "0.01")
    with pytest.raises(InputError, match=rf"a\.mcap: {said}.* needs 0\.03 GB of memory"):
        Recording.open(file)


def test_sparse_file_without_records_is_damaged(tmp_path: Path) -> None:
    """It is not gone through byte by byte: nothing is a record that begins with zero."""
    file = sparse(tmp_path / "a.mcap", _BEGIN, 1 << 36, _DATA_END + the_end())
    with pytest.raises(InputError, match=rf"damaged: no record at byte {len(_BEGIN)}"):
        Recording.open(file)


def test_conflicting_declarations_of_a_schema_are_damage(tmp_path: Path) -> None:
    schemas = [a_record(Op.SCHEMA, b"\1\0", a_text(name), a_text(""), a_text("")) for name in ("a", "b")]
    file = tmp_path / "a.mcap"
    file.write_bytes(_BEGIN + b"".join(schemas) + _DATA_END + the_end())
    with pytest.raises(InputError, match="damaged: schema 1 is declared in two ways"):
        Recording.open(file)


def test_declarations_count_towards_the_memory_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schemas = [
        a_record(Op.SCHEMA, struct.pack("<H", k), a_text(""), a_text(""), a_text("x" * 100_000))
        for k in range(1, 31)
    ]
    file = tmp_path / "a.mcap"
    file.write_bytes(_BEGIN + b"".join(schemas) + _DATA_END + the_end())
    monkeypatch.setenv(LARGEST_VARIABLE, "0.001")
    with pytest.raises(InputError, match="what declares its topics needs"):
        Recording.open(file)
    with pytest.raises(InputError, match="what declares its topics needs"):
        salvage(file, tmp_path / "saved")


def test_salvage_stops_at_the_limit_of_unpacked_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Salvage writes chunks as they are unpacked: a small file does not fill the disk."""
    messages = [(k, bytes(100_000)) for k in range(50)]
    path = foreign(tmp_path / "bag", messages, compression=CompressionMode.STORAGE)
    monkeypatch.setenv(LARGEST_VARIABLE, "0.002")
    with pytest.raises(InputError, match="is unpacked to beyond its size needs"):
        salvage(path, tmp_path / "saved")
    assert sorted(place.name for place in tmp_path.iterdir()) == ["bag"]


def chunks(data: bytearray) -> list[int]:
    """Return where the chunks of a whole file begin."""
    found, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        if opcode == Op.CHUNK:
            found.append(position)
        position += RECORD_HEAD.size + length
    return found


def test_search_for_chunks_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each beginning of a chunk that is none would be read to the end of the file; what was before is kept."""
    whole = next(record(tmp_path / "run", measurements(400)).glob("*.mcap"))
    damaged = bytearray(whole.read_bytes())
    places = chunks(damaged)
    damaged[places[len(places) // 2]] = 0x77
    file = tmp_path / "a.mcap"
    file.write_bytes(damaged)
    assert salvage(file, tmp_path / "usual").losses
    monkeypatch.setattr(survey, "_SEARCHED", 0)
    monkeypatch.setattr(survey, "_SEARCHED_AT_LEAST", 100)
    found = salvage(file, tmp_path / "short")
    assert any("only looks like chunks" in note for note in found.notes)
    assert 0 < found.messages[topics.MEASUREMENT.name] < 300


# ---- definitions of types


def with_definition(file: Path, type_name: str, encoding: str, text: str) -> Path:
    with file.open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(type_name, encoding, text.encode())
        channel = writer.register_channel(topics.MEASUREMENT.name, "cdr", schema)
        writer.add_message(channel, 0, b"\0\1\0\0" + bytes(96), 0)
        writer.finish()
    return file


_DEEP = "(" * 12 + "1" + ")" * 12


@pytest.mark.parametrize(
    ("type_name", "encoding", "text", "said"),
    [
        ("a/msg/B", "ros2msg", "B own\nfloat64 x\n", "message 0 cannot be decoded"),
        (
            "a/msg/B",
            "ros2msg",
            "string[2000000000] x\n",
            "has arrays of 2000000000 elements; allowed: up to 10000",
        ),
        (
            "a/msg/B",
            "ros2msg",
            "a/C[2000000000] x\n",
            "has arrays of 2000000000 elements; allowed: up to 10000",
        ),
        ("a/msg/B", "ros2msg", "float64 x\n" * 20_001, "has 200010 characters; allowed: up to 200000"),
        ("1a/msg/B", "ros2msg", "float64 x\n", "the definition of 1a/msg/B cannot be read"),
        (
            "a/msg/B",
            "ros2idl",
            f"module a {{ const long X = {_DEEP}; }};",
            "unsupported type definition",
        ),
        (
            "a/msg/B",
            "ros2idl",
            "module a { const long X = 1 << 40000000000; };",
            "unsupported type definition",
        ),
        (
            "a/msg/B",
            "ros2idl",
            f"module a {{ struct B {{ {'sequence<' * 40}long{'>' * 40} x; }}; }};",
            "unsupported type definition",
        ),
        ("a/msg/B", "ros2idl", "/*" * 50_000, "the definition of a/msg/B cannot be read"),
    ],
    ids=["itself", "texts", "types", "long", "no name", "brackets", "shift", "sequences", "comments"],
)
def test_implausible_type_definition_is_refused(
    type_name: str, encoding: str, text: str, said: str, tmp_path: Path
) -> None:
    """What would take the parser hours, or code for each of a billion elements, is refused at once."""
    with pytest.raises(InputError) as refused:
        Recording.open(with_definition(tmp_path / "a.mcap", type_name, encoding, text))
    assert said in str(refused.value)
    assert len(str(refused.value)) < 1000


def test_overlong_bench_description_is_refused(tmp_path: Path) -> None:
    """Brackets without end become objects of twenty times their size."""
    with RecordingWriter(tmp_path / "run") as writer:
        writer.write(topics.BENCH, wire.pack_text("[" + "[]," * 400_000 + "[]]"), 0)
        for message in measurements():
            writer.write(topics.MEASUREMENT, message, wire.stamp(message))
    with pytest.raises(
        InputError, match=r"/gyrowheel/bench: a text of 1200013 bytes; allowed: up to 1000000"
    ):
        Recording.open(tmp_path / "run")


# ---- pipes


@pytest.mark.parametrize("name", ["a.mcap", "metadata.yaml"])
def test_pipe_in_a_folder_does_not_block(name: str, tmp_path: Path) -> None:
    folder = record(tmp_path / "run", measurements())
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    if name == "a.mcap":
        with pytest.raises(InputError, match=r"a\.mcap: is no file"):
            salvage(folder, tmp_path / "saved")
    else:
        assert salvage(folder, tmp_path / "saved").messages[topics.MEASUREMENT.name] == 50
    with pytest.raises(InputError, match="exists; a recording needs a new directory"):
        RecordingWriter(folder)
