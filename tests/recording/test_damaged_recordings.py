"""Damaged recordings: each is refused with one line that names the file, or read as if nothing were wrong."""

from __future__ import annotations

import random
import re
import shutil

import pytest
from rosbags.rosbag2 import StoragePlugin

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, RecordingWriter

from .recordings import assert_counting, assert_holds, foreign, measurements


def copy(directory, path):
    shutil.copytree(directory, path)
    return path, next(path.glob("*.mcap"))


def opened_or_refused(path):
    """Return the recording, or the error that says in one line which file is bad."""
    result: Recording | InputError
    try:
        result = Recording.open(path)
    except InputError as error:
        result = error
    assert isinstance(result, Recording) or re.fullmatch(rf"{path}.*: .+", str(result))
    return result


@pytest.mark.slow
def test_truncated_file_is_refused(directory, tmp_path):
    path, file = copy(directory, tmp_path / "cut")
    data = file.read_bytes()
    sizes = random.Random(2).sample(range(len(data)), 60)
    for size in [*sizes, 0, 1, 8, 40, len(data) - 1, len(data) - 8, len(data) - 37]:
        file.write_bytes(data[:size])
        with pytest.raises(InputError, match=rf"^{file}: [^\n]*$"):
            Recording.open(path)


@pytest.mark.slow
def test_every_flipped_bit_is_noticed(directory, tmp_path):
    path, file = copy(directory, tmp_path / "flipped")
    data = file.read_bytes()
    places = random.Random(3).sample(range(len(data)), 150)
    for place in [*places, *range(0, 40, 3), *range(len(data) - 60, len(data))]:
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=rf"^{file}: [^\n]*$"):
            Recording.open(path)


@pytest.mark.slow
def test_file_without_checksums_is_refused_or_read(tmp_path):
    """Without checksums a changed reading cannot be noticed; nothing else may come of it."""
    path = foreign(tmp_path / "bag", [(k, data) for k, data in enumerate(measurements())])
    file = next(path.glob("*.mcap"))
    data = file.read_bytes()
    for place in random.Random(4).sample(range(len(data)), 150):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        file.write_bytes(damaged)
        got = opened_or_refused(path)
        assert isinstance(got, InputError) or len(got.measurement) == 50


def test_damaged_database_is_refused_or_read(tmp_path):
    messages = [(k, data) for k, data in enumerate(measurements())]
    path = foreign(tmp_path / "bag", messages, plugin=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    data = file.read_bytes()
    for size in random.Random(5).sample(range(len(data)), 30):
        file.write_bytes(data[:size])
        got = opened_or_refused(path)
        if isinstance(got, Recording):
            assert_counting(got)


def test_database_with_a_table_description_that_is_no_text_is_refused(tmp_path):
    messages = [(k, data) for k, data in enumerate(measurements())]
    path = foreign(tmp_path / "bag", messages, plugin=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    data = file.read_bytes()
    assert b"CREATE TABLE messages" in data
    file.write_bytes(data.replace(b"CREATE TABLE messages", b"CREATE TABL\xbf messages"))
    with pytest.raises(InputError, match=rf"^{file}: damaged: [^\n]*$"):
        Recording.open(path)


def test_damaged_metadata_is_refused_or_changes_nothing(run, directory, tmp_path):
    path, _ = copy(directory, tmp_path / "metadata")
    file = path / "metadata.yaml"
    data = file.read_bytes()
    rng = random.Random(6)
    variants = [data[:size] for size in rng.sample(range(len(data)), 25)]
    for place in rng.sample(range(len(data)), 50):
        variants.append(data[:place] + bytes([data[place] ^ 1 << (place % 8)]) + data[place + 1 :])
    for variant in variants:
        file.write_bytes(variant)
        got = opened_or_refused(path)
        if isinstance(got, Recording):
            assert_holds(got, run)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "not the metadata of a recording"),
        ("just text", "not the metadata of a recording"),
        ("a: [", "not valid YAML"),
        ("other: {}", "rosbag2_bagfile_information: missing"),
        ("rosbag2_bagfile_information: {}", "relative_file_paths: missing"),
        (
            "rosbag2_bagfile_information:\n  {relative_file_paths: [gone.mcap], message_count: 1,"
            " storage_identifier: mcap}",
            r"gone.mcap: cannot be read: No such file",
        ),
        (
            "rosbag2_bagfile_information:\n  {relative_file_paths: [], message_count: 7,"
            " storage_identifier: mcap}",
            "metadata.yaml counts 7 messages, but the files hold 0",
        ),
        (
            "rosbag2_bagfile_information:\n  {relative_file_paths: [], message_count: 7,"
            " storage_identifier: tape}",
            "metadata.yaml: storage_identifier: 'tape'; allowed: mcap, sqlite3",
        ),
    ],
)
def test_wrong_metadata(tmp_path, text, what):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=what):
        Recording.open(tmp_path)


def test_paths_without_a_recording_are_refused(directory, tmp_path):
    with pytest.raises(InputError, match="nowhere: no such recording"):
        Recording.open(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no metadata.yaml: this is no recording"):
        Recording.open(tmp_path)
    path, file = copy(directory, tmp_path / "begun")
    (path / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"begun: no metadata.yaml: the recording was not completed"):
        Recording.open(path)
    assert len(Recording.open(file).measurement) == 300
    for name, content in {"a.mcap": b"", "b.mcap": b"x" * 100, "c.db3": b"x" * 100, "d.csv": b"1,2"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}: [^\n]+$"):
            Recording.open(tmp_path / name)


def test_recording_without_measurements_is_refused(tmp_path):
    with RecordingWriter(tmp_path / "empty"):
        pass
    with pytest.raises(
        InputError, match=r"empty: no messages on /gyrowheel/measurement; there are: none at all"
    ):
        Recording.open(tmp_path / "empty")
    with RecordingWriter(tmp_path / "bench") as writer:
        writer.write(topics.BENCH, wire.pack_text("a bench"), 0)
    with pytest.raises(InputError, match="there are: /gyrowheel/bench"):
        Recording.open(tmp_path / "bench")
