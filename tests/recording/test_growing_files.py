"""Small files that unpack to more than the memory holds, and what only looks like a file."""

import bz2
import os
import sqlite3
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import mcap.writer
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

from gyrowheel_core import files, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE
from gyrowheel_recording.bags import Recording, RecordingWriter, salvage, write_run
from gyrowheel_recording.mapping.map_file import ColumnMap
from gyrowheel_recording.mapping.table import Table
from gyrowheel_recording.tables import apart, read_grid
from gyrowheel_recording.tables.grid import distinct

from .recordings import make_run

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


@pytest.mark.slow
def test_file_that_unpacks_beyond_the_limit_is_refused(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is refused after a part of it, by every reader, and nothing is written to the disk."""
    monkeypatch.setenv("TMPDIR", "/proc/no/such/place")
    for use in (Recording.open, read_grid):
        with pytest.raises(InputError, match="unpacks to more than 1000 times its size"):
            use(bag)
    with pytest.raises(InputError, match="unpacks to more than 1000 times its size"):
        salvage(bag, tmp_path / "saved")
    assert not (tmp_path / "saved").exists()
    monkeypatch.setenv(LARGEST_VARIABLE, "0.1")
    with pytest.raises(InputError, match=f"{LARGEST_VARIABLE} raises the limit"):
        Recording.open(bag)


def test_messages_beyond_the_memory_limit_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording of more than the limit is refused with the topic and the variable named."""
    with RecordingWriter(tmp_path / "run") as writer:
        writer.write(topics.BENCH, wire.pack_text("x" * 3_000_000), 0)
    monkeypatch.setenv(LARGEST_VARIABLE, "0.002")
    with pytest.raises(
        InputError, match=r"run_0\.mcap: what is recorded on /gyrowheel/bench needs 0\.003 GB"
    ):
        Recording.open(tmp_path / "run")


def test_long_recording_is_not_limited_where_the_file_is_as_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The usual limit is for small files that unpack to more than the memory; a stated one holds for all."""
    write_run(tmp_path / "run", **make_run(20_000))
    assert (tmp_path / "run" / "run_0.mcap").stat().st_size > 2e6
    monkeypatch.setattr(files, "_USUAL", 0.002)
    assert len(Recording.open(tmp_path / "run").measurement) == 20_000
    monkeypatch.setenv(LARGEST_VARIABLE, "0.002")
    with pytest.raises(InputError, match=r"run_0\.mcap: what is recorded on .* needs 0\.00\d* GB of memory"):
        Recording.open(tmp_path / "run")


def test_table_of_one_repeated_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small Parquet file with very many rows is refused before it is read."""
    column = pa.array([1.0] * 200_000).dictionary_encode()
    table = pa.table(dict.fromkeys(("t", *_MEASURED), column))
    pq.write_table(table, tmp_path / "table.parquet")
    (tmp_path / "map.yaml").write_text(_MAP)
    monkeypatch.setenv(LARGEST_VARIABLE, "0.005")
    with pytest.raises(InputError, match="its table needs"):
        Table(tmp_path / "table.parquet", ColumnMap.load(tmp_path / "map.yaml"))


@pytest.mark.slow
def test_columns_that_are_no_readings_take_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists, bytes and repeated texts of gigabytes in a Parquet file of kilobytes."""
    rows = 4000
    columns = {
        "t": pa.array(np.arange(rows) * 1e-3),
        "lists": pa.array([[0.0] * 1000] * rows),
        "bytes": pa.array([bytes(8000)] * rows, pa.binary(8000)),
        "text": pa.array(["x" * 8000] * rows),
    }
    pq.write_table(pa.table(columns), tmp_path / "table.parquet", compression="zstd")
    monkeypatch.setenv(LARGEST_VARIABLE, "0.001")
    code = (
        "import pathlib, pyarrow; from gyrowheel_recording.tables.readers import arrow; "  # not in a fork
        "arrow.read(pathlib.Path('table.parquet'), None); print(pyarrow.default_memory_pool().max_memory())"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert int(done.stdout) < 2_000_000  # each column but the first takes 32 MB
    grid = read_grid(tmp_path / "table.parquet")
    assert set(grid.columns) == {"t", "text"}
    assert "lists is left out: its cells are of list<element: double>" in grid.remarks
    table = pa.table(
        {"t": columns["t"], "tilt_x": columns["lists"]} | dict.fromkeys(_MEASURED[1:], columns["t"])
    )
    pq.write_table(table, tmp_path / "table.parquet")
    (tmp_path / "map.yaml").write_text(_MAP)
    with pytest.raises(
        InputError, match="column 'tilt_x' holds list<element: double>; allowed: numbers and dates"
    ):
        Table(tmp_path / "table.parquet", ColumnMap.load(tmp_path / "map.yaml"))


def test_thousands_of_equal_names_of_columns_are_told_apart(tmp_path: Path) -> None:
    names = distinct(["a", "b", "a", "a (2)", "a"] + ["c"] * 50_000)
    assert names[:5] == ["a", "b", "a (2)", "a (2) (2)", "a (3)"]
    assert len(set(names)) == 50_005


def test_an_index_next_to_a_tdms_file_is_not_read(tmp_path: Path) -> None:
    """It may be of another recording, in which the channels have another order."""
    nptdms = pytest.importorskip("nptdms")

    def write(path: Path, order: tuple[str, str]) -> None:
        with nptdms.TdmsWriter(str(path), index_file=True) as writer:
            writer.write_segment(
                [nptdms.ChannelObject("g", name, np.full(8, float(ord(name)))) for name in order]
            )

    file = tmp_path / "a.tdms"
    write(tmp_path / "other.tdms", ("y", "x"))
    write(file, ("x", "y"))
    for lie in ((tmp_path / "other.tdms_index").read_bytes(), b"secret"):
        (tmp_path / "a.tdms_index").write_bytes(lie)
        columns = read_grid(file).columns
        assert (columns["g/x"].values == ord("x")).all()
        assert (columns["g/y"].values == ord("y")).all()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"PK\x03\x04" + bytes(range(256)), "is a zip archive or a spreadsheet; "),
        (b"\x1f\x8b\x08" + bytes(60), "its compression is damaged"),
        (b"t,a\n\xe9\n", "no rows of numbers found near its beginning"),
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
        Table(tmp_path / "table.csv", ColumnMap.load(tmp_path / "map.yaml"))
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
        Table(tmp_path / "table.csv", ColumnMap.load(tmp_path / "map.yaml"))


# ---- MATLAB


def an_element(kind: int, data: bytes) -> bytes:
    """Return an element of a MATLAB file."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def an_array(kind: int, sizes: tuple[int, ...], *parts: bytes) -> bytes:
    """Return an array of a MATLAB file, of a class and of sizes as they are claimed."""
    head = an_element(6, struct.pack("<II", kind, 0)) + an_element(5, struct.pack(f"<{len(sizes)}i", *sizes))
    return an_element(14, head + an_element(1, b"x") + b"".join(parts))


_NO_FIELDS = an_element(5, struct.pack("<i", 32)) + an_element(1, b"")


@pytest.mark.parametrize(
    "variable",
    [
        an_array(1, (1, 1), an_array(4, (1, 2_000_000_000), an_element(16, b""))),
        an_array(1, (1, 1), an_array(2, (50_000, 50_000), _NO_FIELDS)),
        an_array(1, (2_000_000_000, 1)),
        an_array(2, (1, 1), _NO_FIELDS[:16].replace(b" ", b"\0"), an_element(1, bytes(20_000))),
        an_array(2, (1, 1), an_element(5, struct.pack("<i", 1)), an_element(1, bytes(20_000))),
        an_array(6, (1, 1), an_element(77, bytes(8))),
        an_array(99, (1, 1)),
        an_array(6, (1, -1), an_element(9, bytes(8))),
    ],
    ids=["text", "structures", "cells", "names", "fields", "type", "class", "size"],
)
@pytest.mark.parametrize("packed", [False, True], ids=["plain", "packed"])
def test_matlab_file_with_false_sizes_is_refused(variable: bytes, packed: bool, tmp_path: Path) -> None:
    file = tmp_path / "t.mat"
    if packed:
        small = zlib.compress(variable)
        variable = struct.pack("<II", 15, len(small)) + small
    file.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + variable)
    with pytest.raises(InputError, match=r"t\.mat: (cannot be read: |has no columns of numbers)"):
        read_grid(file)


@pytest.mark.slow
def test_a_structure_of_matlab_that_unpacks_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is within a structure counts, and the bytes that it is packed in do not."""
    from scipy.io import savemat

    savemat(tmp_path / "t.mat", {"run": {"a": np.zeros(25_000_000)}}, do_compression=True)
    assert (tmp_path / "t.mat").stat().st_size < 500_000
    assert len(read_grid(tmp_path / "t.mat").columns["run.a"].values) == 25_000_000
    monkeypatch.setenv(LARGEST_VARIABLE, "0.01")
    with pytest.raises(InputError, match=r"cannot be read: damaged, or it needs more memory than 0\.01 GB"):
        read_grid(tmp_path / "t.mat")


def test_an_old_matlab_file_with_a_negative_size_is_refused(tmp_path: Path) -> None:
    """A variable of less than nothing, behind which the same one follows for ever."""
    (tmp_path / "t.mat").write_bytes(struct.pack("<5i", 0, -1, 1, 0, 2) + b"x\0")
    with pytest.raises(InputError, match="cannot be read: "):
        read_grid(tmp_path / "t.mat")


# ---- HDF5


def test_records_of_hdf5_count_with_their_bytes(tmp_path: Path) -> None:
    import h5py

    kind = np.dtype([("t", "<f8"), ("text", "S1000000000")])
    with h5py.File(tmp_path / "t.h5", "w") as file:
        file.create_dataset("x", (4,), kind, chunks=None)
    assert (tmp_path / "t.h5").stat().st_size < 10_000
    with pytest.raises(InputError, match=r"its table needs 8 GB of memory"):
        read_grid(tmp_path / "t.h5")


def test_external_and_virtual_datasets_of_hdf5_are_not_read(tmp_path: Path) -> None:
    import h5py

    os.mkfifo(tmp_path / "pipe")
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file["x"] = np.arange(5.0)
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset("x", (5,), "<f8", external=[(str(tmp_path / "pipe"), 0, 40)])
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout((5,), "<f8")
        layout[:] = h5py.VirtualSource(tmp_path / "own.h5", "x", (5,))
        file.create_virtual_dataset("x", layout)
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["linked"] = h5py.ExternalLink(tmp_path / "own.h5", "x")
        file["y"] = np.arange(3.0)
    with pytest.raises(InputError, match=r"x: its numbers are in another file \(external storage\)"):
        read_grid(tmp_path / "external.h5")
    with pytest.raises(InputError, match=r"x: its numbers are in other data sets \(it is virtual\)"):
        read_grid(tmp_path / "virtual.h5")
    assert list(read_grid(tmp_path / "link.h5").columns) == ["y"]


def test_a_chunk_of_hdf5_that_unpacks_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """HDF5 unpacks a chunk to its end, however many bytes a chunk has."""
    import h5py

    n = 8192  # HDF5 1 refuses a chunk whose length has more bytes than that of what it should hold
    for name, content in (("good", np.arange(float(n)).tobytes()), ("bad", bytes(200_000_000))):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            data = file.create_dataset("x", (n,), "<f8", chunks=(n,), compression="gzip", fletcher32=False)
            data.id.write_direct_chunk((0,), zlib.compress(content))
    monkeypatch.setenv(LARGEST_VARIABLE, "0.001")
    assert read_grid(tmp_path / "good.h5").columns["x"].values.tolist() == list(range(n))
    with pytest.raises(InputError, match=r"bad\.h5: cannot be read: "):
        read_grid(tmp_path / "bad.h5")


def test_groups_of_hdf5_within_groups(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "t.h5", "w") as file:
        file["/".join("g" * 60) + "/x"] = np.arange(3.0)
    with pytest.raises(InputError, match="has groups within groups, more than 50 deep"):
        read_grid(tmp_path / "t.h5")


# ---- TDMS and MDF


@pytest.mark.parametrize("name", ["NI_Number_Of_Scales", "NI_Scale[2000000000]_Scale_Type"])
def test_scales_of_tdms_without_end(name: str, tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "t.tdms") as out:
        channel = nptdms.ChannelObject("run", "x", np.arange(5.0), {name: 2_000_000_000})
        out.write_segment([channel])
    with pytest.raises(InputError, match=r"t\.tdms: cannot be read: damaged, or it needs more memory"):
        read_grid(tmp_path / "t.tdms")


def measured(file: Path, *, packed: int = 0, formula: str = "") -> bytearray:
    """Write an MDF file of 20000 zeros, or of 0 to 4 by a formula, and return its content."""
    asammdf = pytest.importorskip("asammdf")
    from asammdf.blocks.v4_blocks import ChannelConversion

    values = np.arange(5.0) if formula else np.zeros(20_000)
    conversion = ChannelConversion(conversion_type=3, formula=formula) if formula else None
    with asammdf.MDF(version="4.10") as out:
        time = np.arange(len(values)) * 1e-3
        out.append([asammdf.Signal(values, time, name="x", unit="V", conversion=conversion)])
        out.save(file, overwrite=True, compression=packed)
    return bytearray(file.read_bytes())


def test_compressed_values_of_mdf_count_towards_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "t.mf4"
    measured(file, packed=1)
    assert np.array_equal(read_grid(file).columns["x"].values, np.zeros(20_000))
    monkeypatch.setenv(LARGEST_VARIABLE, "0.0003")
    with pytest.raises(InputError, match=r"its table needs 0\.00096 GB of memory"):
        read_grid(file)


def test_lists_of_mdf_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A group that is followed by itself."""
    monkeypatch.setattr(apart, "_TIME", 1.0)
    monkeypatch.setattr(apart, "_TIME_A_BYTE", 0.0)
    file = tmp_path / "t.mf4"
    damaged = measured(file)
    place = damaged.find(b"##DG")
    damaged[place + 24 : place + 32] = struct.pack("<Q", place)
    file.write_bytes(damaged)
    with pytest.raises(InputError, match=r"t\.mf4: cannot be read: it takes more than 1 s"):
        read_grid(file)


def test_a_group_of_mdf_that_has_fewer_records_than_it_states(tmp_path: Path) -> None:
    file = tmp_path / "t.mf4"
    content = measured(file)
    place = content.find(b"##CG")
    place += 24 + 8 * struct.unpack_from("<Q", content, place + 16)[0] + 8
    assert struct.unpack_from("<Q", content, place) == (20_000,)
    content[place : place + 8] = struct.pack("<Q", 30_000)
    file.write_bytes(content)
    with pytest.raises(InputError, match="time: damaged: it has 20000 values, where 30000 are stated"):
        read_grid(file)


def test_a_channel_of_mdf_beyond_its_record(tmp_path: Path) -> None:
    """The library wrote beyond its memory, and the program ended."""
    file = tmp_path / "t.mf4"
    content = measured(file)
    place = content.find(b"##CN")
    place = content.find(b"##CN", place + 1)  # behind the clock
    links = struct.unpack_from("<Q", content, place + 16)[0]
    content[place + 24 + 8 * links + 4 : place + 24 + 8 * links + 8] = struct.pack("<I", 1000)
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged: it is not within the 16 bytes of a record"):
        read_grid(file)


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os').mkdir('{folder}/run')",
        "X1.__class__",
        "[].append(X1)",
        "X1 if X1 else X1",
        "open",
        "exp(X1, out=X1)",
        "'a' * 1000000000",
        "(" * 300 + "X1" + ")" * 300,
    ],
)
def test_a_formula_in_an_mdf_file_is_never_run(formula: str, tmp_path: Path) -> None:
    """The library hands it to what runs it as Python, where all else fails."""
    file = tmp_path / "t.mf4"
    measured(file, formula=formula.replace("{folder}", str(tmp_path)))
    with pytest.raises(InputError, match=r"x: its values are by the formula .* which is not read"):
        read_grid(file, ["x"])
    grid = read_grid(file)
    assert list(grid.columns) == ["time"]
    assert "is not read: left out" in grid.remarks[0]
    assert [own.name for own in tmp_path.iterdir()] == ["t.mf4"]


def test_a_formula_in_an_mdf_file_is_computed(tmp_path: Path) -> None:
    file = tmp_path / "t.mf4"
    measured(file, formula="sqrt(X1)*2 + X1**2/4 - 1")
    column = read_grid(file).columns["x"]
    x = np.arange(5.0)
    assert column.values == pytest.approx(2.0 * np.sqrt(x) + x**2 / 4.0 - 1.0)
    assert column.unit == "V"
    measured(file, formula="9**9**9**9*X1")  # not a number of that many digits
    assert read_grid(file).columns["x"].values[1] == np.inf


# ---- bags by `import`


def a_record(fields: dict[str, bytes], data: bytes) -> bytes:
    """Return a record of a bag of ROS 1."""
    items = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(own)) + own for own in items)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def ros1_bag(file: Path, way: str, size: int, chunk: bytes, count: int = 1) -> Path:
    """Write a bag of ROS 1 of one chunk."""
    head = {"op": b"\3", "index_pos": b"\1" * 8, "conn_count": bytes(4), "chunk_count": struct.pack("<I", 1)}
    packed = {"op": b"\5", "compression": way.encode(), "size": struct.pack("<I", size)}
    index = a_record({"op": b"\6"}, struct.pack("<II", 0, count))
    file.write_bytes(b"#ROSBAG V2.0\n" + a_record(head, bytes(100)) + a_record(packed, chunk) + index)
    return file


def a_connection(definition: str, digest: str = "*") -> bytes:
    """Return what declares the topic /x of a bag of ROS 1."""
    texts = {"type": "a/B", "md5sum": digest, "message_definition": definition}
    items = [f"{name}={value}".encode() for name, value in texts.items()]
    about = b"".join(struct.pack("<I", len(own)) + own for own in items)
    return a_record({"op": b"\7", "conn": bytes(4), "topic": b"/x"}, about)


def test_chunks_of_ros_1_that_unpack_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = 20_000_000
    bag = ros1_bag(tmp_path / "t.bag", "bz2", size, bz2.compress(bytes(size)))
    with pytest.raises(InputError, match=r"t\.bag: unpacks to more than 1000 times its size"):
        read_grid(bag)
    monkeypatch.setenv(LARGEST_VARIABLE, "0.01")
    with pytest.raises(InputError, match=r"t\.bag: a chunk of it needs 0\.02 GB of memory"):
        read_grid(bag)
    ros1_bag(bag, "bz2", 1000, bz2.compress(bytes(size)))
    with pytest.raises(InputError, match="damaged: a chunk of 1001 bytes that states 1000"):
        read_grid(bag)
    ros1_bag(bag, "none", 1000, bytes(1000))
    with pytest.raises(InputError, match="damaged: a record without its field op"):
        read_grid(bag)


_EMPTY = "=" * 80 + "\nMSG: a/C\n"


@pytest.mark.parametrize(
    ("definition", "digest", "said"),
    [
        (f"C[] x\n{_EMPTY}", "*", "cannot be read: "),
        (f"C x\n{_EMPTY}B y\n", "*", "the definition of a/msg/B cannot be read"),
        ("string[2000000000] x\n", "*", "has arrays of 2000000000 elements; allowed: up to 10000"),
        ("float64 x\n", "0" * 32, "is damaged: its checksum is "),
        ("D x\n", "*", "the definition of a/msg/B cannot be read"),
    ],
    ids=["lists", "itself", "texts", "checksum", "unknown"],
)
@pytest.mark.slow
def test_nested_types_of_ros_1_beyond_the_limit_are_refused(
    definition: str, digest: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_TIME", 1.0)
    message = a_record({"op": b"\2", "conn": bytes(4), "time": bytes(8)}, struct.pack("<I", 1 << 31))
    chunk = a_connection(definition, digest) + message
    bag = ros1_bag(tmp_path / "t.bag", "none", len(chunk), chunk)
    for names in (None, ["/x.x"]):
        with pytest.raises(InputError) as refused:
            read_grid(bag, names)
        assert said in str(refused.value)
        assert str(refused.value).startswith(f"{bag}: ")


def test_a_message_of_a_bag_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    """A list of more than there is, in ROS 1, and in ROS 2 of messages without anything in them."""
    message = a_record({"op": b"\2", "conn": bytes(4), "time": bytes(8)}, struct.pack("<I", 1 << 31))
    chunk = a_connection("float64[] x\n") + message
    bag = ros1_bag(tmp_path / "t.bag", "none", len(chunk), chunk)
    with pytest.raises(
        InputError, match=r"t\.bag: has no columns of numbers: /x: message 0 cannot be decoded"
    ):
        read_grid(bag)
    with (tmp_path / "t.mcap").open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("a/msg/B", "ros2msg", f"C[] x\n{_EMPTY}".encode())
        channel = writer.register_channel("/x", "cdr", schema)
        writer.add_message(channel, 0, b"\0\1\0\0" + struct.pack("<I", 1 << 31), 0)
        writer.finish()
    with pytest.raises(InputError, match="/x: message 0 cannot be decoded"):
        read_grid(tmp_path / "t.mcap")


def test_a_bag_of_ros_1_with_another_index(tmp_path: Path) -> None:
    """Messages are gone through once, and are as many as the index states."""
    message = a_record({"op": b"\2", "conn": bytes(4), "time": bytes(8)}, struct.pack("<d", 1.5))
    chunk = a_connection("float64 x\n") + message + message
    bag = ros1_bag(tmp_path / "t.bag", "none", len(chunk), chunk, count=2)
    assert read_grid(bag).columns["/x.x"].values.tolist() == [1.5, 1.5]
    ros1_bag(bag, "none", len(chunk), chunk, count=1000)
    with pytest.raises(InputError, match="damaged: 2 messages in 1 chunks, where its index states 1000 in 1"):
        read_grid(bag)


def test_import_runs_no_code_of_a_database_that_is_no_bag(tmp_path: Path) -> None:
    connection = sqlite3.connect(tmp_path / "t.db3")
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
        "CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c) SELECT * FROM c;"
    )
    connection.close()
    with pytest.raises(InputError, match="its 'messages' is a view"):
        read_grid(tmp_path / "t.db3")
