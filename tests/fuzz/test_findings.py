"""What the fuzzers found, each with its smallest input."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import mcap.writer
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import gyrowheel as gw
from gyrowheel.cli.internal_errors import machine_error
from gyrowheel.show.sentences.setup import problem
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.segmentation import steady_spans
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import files, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import read_text
from gyrowheel_core.units import conversion
from gyrowheel_recording.bags import Recording, RecordingWriter
from gyrowheel_recording.bags.columns import definition
from gyrowheel_recording.mapping import ColumnMap, import_table
from gyrowheel_recording.tables import apart, read_grid
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.user_defined_line import typed_effect
from gyrowheel_sim.environment import from_json

from ..domains import next_domain
from .contents import written
from .nodes import Listening
from .recordings import machine_recording, messages, originals
from .tables import text_table
from .texts import MAP

_DEEP = "[" * 100_000
_LONG = "9" * 400


def test_characters_that_a_terminal_obeys_are_escaped(tmp_path: Path) -> None:
    """A message quotes what stands in a file, but not so that a terminal would act on it."""
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    for odd in ("\x1b[31m", "\u2028", "\u202e", "\x07"):
        table = tmp_path / "table.csv"
        table.write_text(text_table().replace("3000.0", odd, 1), encoding="utf-8")
        with pytest.raises(InputError) as refused:
            import_table(table, ColumnMap.load(tmp_path / "map.yaml"), tmp_path / "run")
        assert str(refused.value).isprintable()
        assert odd.encode("unicode_escape").decode() in str(refused.value)


@pytest.mark.parametrize("load", [Plan.load, Bench.load, Recording.open])
def test_a_name_that_no_file_can_have(load) -> None:
    with pytest.raises(InputError, match="File name too long"):
        load("9" * 400)


def test_an_error_of_a_path_is_no_defect() -> None:
    """A folder that may not be read is the user's matter; without a path, or further down, it is ours."""
    error = PermissionError(errno.EACCES, "Permission denied", "runs/q")
    assert machine_error(error) == "Permission denied: runs/q"
    assert machine_error(OSError(errno.ENOTDIR, "Not a directory")) is None
    other = KeyError("x")
    other.__context__ = error
    assert machine_error(other) is None


@pytest.mark.parametrize("unit", ["11/K", "N1m/rad", "N m", "m2"])
def test_a_unit_without_signs_between_its_factors(unit: str) -> None:
    with pytest.raises(InputError, match="is no unit; write it like"):
        typed_effect(f"own: coil_gain = a*(T_coil - T_ref); a [{unit}]")


@pytest.mark.parametrize("unit", ["+g*m^2", "--kg*m^2", "kg*(+m^2)"])
def test_a_unit_with_a_sign(unit: str) -> None:
    with pytest.raises(InputError, match="a unit has no sign"):
        conversion(unit, "kg*m^2")
    assert conversion("kg*m^+2", "kg*m^2") == conversion("1/kg^-1*m**(+2)", "kg*m^2") == (0.0, 1.0)


@pytest.mark.parametrize("key", ["spin_rpm", "tilt_deg"])
def test_a_block_of_a_plan_without_values(key: str) -> None:
    text = f"schema: 1\nname: t\nsegments:\n  - {{{key}: []}}\n  - {{cone_radius_deg: 3, cone_period_s: 2}}\n"
    with pytest.raises(InputError, match=f"segments.0: {key} is an empty list; allowed: at least one value"):
        Plan.load(text)


def test_a_column_of_parquet_whose_name_is_no_text(tmp_path: Path) -> None:
    table = tmp_path / "table.parquet"
    pq.write_table(pa.table({"spin": [1.0, 2.0]}), table)
    table.write_bytes(table.read_bytes().replace(b"spin", b"s\xffin"))
    with pytest.raises(InputError, match=r"table\.parquet: cannot be read: "):
        read_grid(table)


@pytest.mark.graph
def test_a_clock_that_is_none_is_passed_over() -> None:
    """The conductor goes by the next one; a second of more than a second is no time either."""
    listening = Listening(next_domain())
    try:
        for data in (b"", wire.CLOCK.pack(1)[:-1], wire.CLOCK.pack(0)[:8] + b"\xff" * 4):
            assert listening.give(topics.CLOCK.name, data) == "taken"
    finally:
        listening.close()


def test_a_pipe_and_a_text_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "wheel.yaml")
    with pytest.raises(InputError, match="it is a pipe, not a file"):
        read_text(tmp_path / "wheel.yaml")
    monkeypatch.setattr(files, "LONGEST_TEXT", 1000)
    with pytest.raises(InputError, match="is too long to be read; allowed: up to 1000 characters"):
        read_text(Path("/dev/zero"))


@pytest.mark.parametrize(
    "text",
    [_DEEP, '[{"time": 1e308}]', '[{"time": Infinity}]', f'[{{"time": {_LONG}}}]', f'[{{"yaw": {_LONG}}}]'],
)
def test_an_environment_of_brackets_or_digits(text: str) -> None:
    with pytest.raises(InputError, match="environment"):
        from_json(text)


def test_a_definition_that_changes_a_type_of_ros(tmp_path: Path) -> None:
    text = definition("gyrowheel_msgs/msg/Measurement").text.replace("uint32 nanosec", "uint32 nanosek")
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = mcap.writer.Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("gyrowheel_msgs/msg/Measurement", "ros2msg", text.encode())
        channel = writer.register_channel(topics.MEASUREMENT.name, "cdr", schema)
        # of another layout than ours, so that the definition is needed
        writer.add_message(channel, 0, b"\0\1\0\0" + bytes(96), 0)
        writer.finish()
    with pytest.raises(InputError, match=r"the definition of gyrowheel_msgs/msg/Measurement cannot be read"):
        Recording.open(tmp_path / "run.mcap")


@pytest.mark.parametrize("text", [_DEEP, f'{{"name": "x", "parameters": {{"a": {{"value": {_LONG}}}}}}}'])
def test_a_bench_of_brackets_or_digits_in_a_recording(text: str, tmp_path: Path) -> None:
    """It counts as no description."""
    with RecordingWriter(tmp_path / "run") as writer:
        writer.write(topics.BENCH, wire.pack_text(text), 0)
        for topic, stamp, data in messages(10):
            writer.write(topic, data, stamp)
    assert Recording.open(tmp_path / "run").carried_bench is None


# ---- files of measurement programs


@pytest.mark.parametrize(
    ("length", "number"), [(5, 1), (16385, 1), (5, 7)], ids=["whole", "longer", "another"]
)
def test_a_unit_in_hdf5_that_is_not_where_it_should_be(length: int, number: int, tmp_path: Path) -> None:
    """HDF5 read beyond its memory, and the program ended."""
    import h5py

    file = tmp_path / "t.h5"
    with h5py.File(file, "w") as out:
        out["x"] = np.arange(3.0)
        out["x"].attrs["unit"] = "deg/s"
    content = file.read_bytes()
    heap = content.find(b"GCOL")
    stored = struct.pack("<IQI", 5, heap, 1)
    assert content.count(stored) == 1
    file.write_bytes(content.replace(stored, struct.pack("<IQI", length, heap, number)))
    if (length, number) == (5, 1):
        assert read_grid(file).columns["x"].unit == "deg/s"
        return
    with pytest.raises(InputError, match=r"t\.h5: cannot be read: "):
        read_grid(file)


def test_a_heap_of_hdf5_without_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """HDF5 looked for the end of the heap for ever: what is free in it has no size."""
    import h5py

    file = tmp_path / "t.h5"
    with h5py.File(file, "w") as out:
        out["x"] = np.arange(3.0)
        out["x"].attrs["unit"] = "deg/s"
    content = bytearray(file.read_bytes())
    heap = content.find(b"GCOL")
    content[heap + 16 : heap + 16 + 24] = bytes(24)
    file.write_bytes(content)
    monkeypatch.setattr(apart, "_TIME", 1.0)
    with pytest.raises(InputError, match=r"t\.h5: cannot be read: "):
        read_grid(file)


def test_a_type_of_hdf5_that_numpy_does_not_know(tmp_path: Path) -> None:
    import h5py

    file = tmp_path / "t.h5"
    with h5py.File(file, "w") as out:
        out["x"] = np.arange(3.0)
        h5py.h5d.create(out.id, b"odd", h5py.h5t.UNIX_D32LE, h5py.h5s.create_simple((3,)))
    grid = read_grid(file)
    assert list(grid.columns) == ["x"]
    assert grid.remarks[0].startswith("odd is left out: No NumPy equivalent")
    with pytest.raises(InputError, match=r"t\.h5: cannot be read: No NumPy equivalent"):
        read_grid(file, ["odd"])


def test_a_sparse_matrix_of_matlab_is_no_column(tmp_path: Path) -> None:
    """It was looked into without end."""
    from scipy.io import savemat
    from scipy.sparse import eye_array

    savemat(
        tmp_path / "t.mat",
        {"s": eye_array(5).tocsc(), "run": {"s": eye_array(5).tocsc()}, "x": np.arange(3.0)},
    )
    assert list(read_grid(tmp_path / "t.mat").columns) == ["x"]


def test_a_damaged_mdf_file_is_told_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The library writes a traceback of its own as it lets go of such a file."""
    asammdf = pytest.importorskip("asammdf")
    file = tmp_path / "t.mf4"
    with asammdf.MDF(version="4.10") as out:
        out.append([asammdf.Signal(np.arange(5.0), np.arange(5.0), name="x")])
        out.save(file, overwrite=True)
    file.write_bytes(file.read_bytes().replace(b"##CG", b"##XX"))
    capfd.readouterr()
    with pytest.raises(InputError, match=r"t\.mf4: cannot be read: "):
        read_grid(file)
    assert capfd.readouterr() == ("", "")


def test_a_tdms_file_that_breaks_off_is_told(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    nptdms = pytest.importorskip("nptdms")
    file = tmp_path / "t.tdms"
    with nptdms.TdmsWriter(file) as out:
        out.write_segment([nptdms.ChannelObject("run", "x", np.arange(50.0))])
    file.write_bytes(file.read_bytes()[:-80])
    grid = read_grid(file)
    assert len(grid.columns["run/x"].values) == 40
    assert grid.remarks == ("the file breaks off: its last segment is read as far as it goes",)
    assert capfd.readouterr() == ("", "")


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("odd", ["1e308", "-1e308", "1e12"])
def test_a_time_that_no_recording_reaches(odd: str, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    table = tmp_path / "table.csv"
    first, *rows = text_table().strip().split("\n")
    last = odd + rows[-1][rows[-1].index(",") :]
    table.write_text("\n".join([first, *rows[:-1], last]), encoding="utf-8")
    with pytest.raises(
        InputError, match=r"column 't_ms', line 41: .* s from the first row; allowed: up to 1e\+08 s"
    ):
        import_table(table, ColumnMap.load(tmp_path / "map.yaml"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_database_whose_tables_ask_for_any_memory(tmp_path: Path) -> None:
    """SQLite refuses such a length before it takes the memory; that is damage, and no lack of memory."""
    whole = originals(tmp_path / "originals")
    (folder,) = [own.folder for own in whole if own.folder.name == "sqlite3 plain"]
    (file,) = folder.glob("*.db3")
    data = bytearray(file.read_bytes())
    data[1017:3021] = b"\xff" * 2004
    file.write_bytes(data)
    with pytest.raises(InputError, match="damaged: its description of the tables asks"):
        Recording.open(folder)


@pytest.mark.parametrize(
    ("line", "kind", "words"),
    [
        ("all rate 3", "clock", "the times of the samples are divided by 3"),
        ("measurement times tilt_y 0.5", "scale", "tilt_y is read half as large as it is"),
    ],
)
def test_no_law_is_sought_for_what_none_can_explain(tmp_path: Path, line: str, kind: str, words: str) -> None:
    """A comparison took up to half a minute for it."""
    whole = machine_recording(tmp_path / "whole", lacking=False)
    wrong = gw.Recording.open(written(whole, [line], tmp_path / "run"))
    said: list[str] = []
    found = gw.compare(wrong, gw.Model("gyrowheel"), progress=said.append)
    assert [own.kind for own in found.setup] == [kind]
    assert words in problem(found.setup[0])
    assert said
    assert not any("comparing with" in text for text in said)


def test_holds_of_setpoints_with_scattered_times_do_not_overlap(tmp_path: Path) -> None:
    """A step among windows that overlap had a negative norm: a comparison ended with an internal error."""
    whole = machine_recording(tmp_path / "whole", lacking=True)
    own = Recording.open(written(whole, ["setpoint jitter 40000 1"], tmp_path / "run"))
    spans = steady_spans(samples_of(own))
    assert len(spans) > 3
    assert all(end <= then for (_, end, *_), (then, *_) in pairwise(spans))


@pytest.mark.parametrize("name", ["motor_voltage", "coil_voltage_y"])
def test_another_signal_in_a_column_is_named_where_it_leaves_no_steady_motion(
    tmp_path: Path, name: str
) -> None:
    """The angle jumps once a turn, as if a motion began at the end of every window."""
    whole = machine_recording(tmp_path / "whole", lacking=False)
    wrong = gw.Recording.open(written(whole, [f"measurement mixed {name} spin_angle"], tmp_path / "run"))
    model = gw.Model("gyrowheel")
    with pytest.raises(gw.InputError, match=f"{name} is another signal.* --without {name}"):
        gw.compare(wrong, model)
    found = gw.diagnose(wrong, model)
    assert found.verdict == "insufficient_data"
    assert [own.kind for own in found.setup] == ["foreign"]


@pytest.mark.slow
def test_a_rotor_whose_spin_rate_reads_zero_is_a_wrong_setup(tmp_path: Path) -> None:
    """The mean tilt rate of a window divided by its spin rate."""
    whole = machine_recording(tmp_path / "whole", lacking=False)
    wrong = gw.Recording.open(written(whole, ["measurement times spin_rate 0"], tmp_path / "run"))
    found = gw.compare(wrong, gw.Model("gyrowheel"))
    assert [own.kind for own in found.setup] == ["stuck"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "lines"),
    [
        (
            gw.compare,
            ["mixed motor_current air_pressure", "mixed motor_voltage motor_current"],
        ),
        (gw.diagnose, ["mixed motor_current coil_voltage_y", "rate 3", "times spin_angle 0.99"]),
    ],
)
@pytest.mark.parametrize("lacking", [False, True])
def test_absurd_readings_are_refused_or_answered(
    verb: Callable[..., object], lines: list[str], lacking: bool, tmp_path: Path
) -> None:
    """A matrix was singular, or a fit at the next test was not finite: an internal error."""
    whole = machine_recording(tmp_path / "whole", lacking=lacking)
    wrong = written(whole, [f"measurement {line}" for line in lines], tmp_path / "run")
    with contextlib.suppress(InputError):
        assert verb(gw.Recording.open(wrong), gw.Model("gyrowheel"))
