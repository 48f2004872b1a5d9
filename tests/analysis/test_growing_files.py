"""Small files that unpack to more than the memory holds, and what only looks like a file."""

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

from gyrowheel_analysis.exchange.column_map import ColumnMap
from gyrowheel_analysis.exchange.table import Table
from gyrowheel_analysis.recording import Recording, RecordingWriter, salvage
from gyrowheel_core import limits, topics, wire
from gyrowheel_core.errors import InputError

#: Columns of the map.
_MEASURED = (
    "tilt_x", "tilt_y", "spin_angle", "spin_rate", "coil_voltage_x", "coil_voltage_y", "motor_voltage", "motor_current",
)  # fmt: skip
_MAP = """\
schema: 1
time: {column: t, unit: s}
columns:
  tilt_x: {column: tilt_x, unit: rad}
  tilt_y: {column: tilt_y, unit: rad}
  spin_angle: {column: spin_angle, unit: rad}
  spin_rate: {column: spin_rate, unit: rad/s}
  coil_voltage_x: {column: coil_voltage_x, unit: V}
  coil_voltage_y: {column: coil_voltage_y, unit: V}
  motor_voltage: {column: motor_voltage, unit: V}
  motor_current: {column: motor_current, unit: A}
  coil_temperature: {value: 293, unit: K}
  air_temperature: {value: 293, unit: K}
  air_pressure: {value: 1013, unit: hPa}
"""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Write a recording compressed as a file, which unpacks to 2 GB of nothing."""
    folder = tmp_path / "bag"
    with RecordingWriter(folder) as writer:
        writer.write(topics.BENCH, wire.pack_text("x"), 0)
    plain = folder / "bag_0.mcap"
    compressor = zstandard.ZstdCompressor()
    with (folder / "bag_0.mcap.zstd").open("wb") as file, compressor.stream_writer(file) as stream:
        stream.write(plain.read_bytes())
        for _ in range(128):
            stream.write(bytes(1 << 24))
    plain.unlink()
    metadata = folder / "metadata.yaml"
    text = metadata.read_text().replace("bag_0.mcap", "bag_0.mcap.zstd")
    text = text.replace("compression_mode: ''", "compression_mode: FILE")
    metadata.write_text(text.replace("compression_format: ''", "compression_format: zstd"))
    assert "FILE" in text
    return folder


def test_file_that_unpacks_without_end(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is refused after a part of it, by every reader, and nothing is written to the disk."""
    monkeypatch.setenv("TMPDIR", "/proc/no/such/place")
    with pytest.raises(InputError, match="unpacks to more than 1000 times its size"):
        Recording.open(bag)
    with pytest.raises(InputError, match="unpacks to more than 1000 times its size"):
        salvage(bag, tmp_path / "saved")
    assert not (tmp_path / "saved").exists()
    monkeypatch.setenv(limits.VARIABLE, "0.1")
    with pytest.raises(InputError, match=f"{limits.VARIABLE} raises the limit"):
        Recording.open(bag)


def test_messages_beyond_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording of more than the limit is refused with the topic and the variable named."""
    with RecordingWriter(tmp_path / "run") as writer:
        writer.write(topics.BENCH, wire.pack_text("x" * 3_000_000), 0)
    monkeypatch.setenv(limits.VARIABLE, "0.002")
    with pytest.raises(
        InputError, match=r"run_0\.mcap: what is recorded on /gyrowheel/bench needs 0\.003 GB"
    ):
        Recording.open(tmp_path / "run")


def test_table_of_one_repeated_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small Parquet file with very many rows is refused before it is read."""
    column = pa.array([1.0] * 200_000).dictionary_encode()
    table = pa.table(dict.fromkeys(("t", *_MEASURED), column))
    pq.write_table(table, tmp_path / "table.parquet")
    (tmp_path / "map.yaml").write_text(_MAP)
    monkeypatch.setenv(limits.VARIABLE, "0.005")
    with pytest.raises(InputError, match="its table of 200000 rows needs"):
        Table(tmp_path / "table.parquet", ColumnMap.load(tmp_path / "map.yaml"))._read()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"PK\x03\x04" + bytes(range(256)), "is a zip archive or a spreadsheet; "),
        (b"\x1f\x8b\x08" + bytes(60), "its compression is damaged"),
        (b"t,a\n\xe9\n", "byte 5 is no text in utf-8"),
        (b"t,a\n\0\n", "has a zero byte near its beginning"),
    ],
)
def test_table_that_is_no_text(
    content: bytes, said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """What is called .csv and is none is told as what it is, without a byte of it."""
    (tmp_path / "table.csv").write_bytes(content)
    (tmp_path / "map.yaml").write_text(_MAP)
    with pytest.raises(InputError) as refused:
        Table(tmp_path / "table.csv", ColumnMap.load(tmp_path / "map.yaml"))._read()
    assert said in str(refused.value)
    assert str(refused.value).isprintable()
    assert capfd.readouterr() == ("", "")


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    """A pipe in the place of a file is refused."""
    for name in ("run.mcap", "table.csv"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "map.yaml").write_text(_MAP)
    with pytest.raises(InputError, match="neither a directory nor a file"):
        Recording.open(tmp_path / "run.mcap")
    with pytest.raises(InputError, match="is not a file"):
        Table(tmp_path / "table.csv", ColumnMap.load(tmp_path / "map.yaml"))._read()
