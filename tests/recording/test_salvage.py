"""Salvage: what is whole in a broken recording comes back exactly, and what is missing is said."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import mcap.writer
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from gyrowheel.cli.app import app
from gyrowheel.cli.console import run
from gyrowheel.recordings.page import salvage_page
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, RecordingWriter, info, salvage
from gyrowheel_recording.bags.columns import definition, typestore
from gyrowheel_recording.bags.mcap import RECORD_HEAD, Op

from .recordings import shown

PERIOD_NS = 500_000
SAMPLES = 1000


def messages(count=SAMPLES, start=0):
    for k in range(start, start + count):
        stamp = k * PERIOD_NS
        yield topics.MEASUREMENT, stamp, wire.MEASUREMENT.pack(stamp, k, *(float(k + i) for i in range(11)))
        yield topics.COMMAND, stamp, wire.COMMAND.pack(stamp, k, 1.0 * k, 2.0 * k, 3.0 * k)


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Write a recording with many small chunks."""
    path = tmp_path_factory.mktemp("salvage") / "run"
    with RecordingWriter(path, chunk_size=8000) as writer:
        writer.write(topics.BENCH, wire.pack_text("the bench"), 0)
        for message in messages():
            writer.write(message[0], message[2], message[1])
    return path


@pytest.fixture
def data(whole):
    return (whole / "run_0.mcap").read_bytes()


def chunks(data):
    """Return where the chunks of a whole file begin and end."""
    found, position = [], 8
    while position < len(data) - 8:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        if opcode == Op.CHUNK:
            found.append((position, position + 9 + length))
        position += 9 + length
    return found


def broken(tmp_path, data, name="broken"):
    file = tmp_path / f"{name}.mcap"
    file.write_bytes(data)
    return file


def saved(tmp_path, source):
    """Salvage, see that the source is as it was, and that everybody can read what was saved."""
    before = {f: f.read_bytes() for f in ([source] if source.is_file() else source.iterdir())}
    target = tmp_path / "saved"
    result = salvage(source, target)
    assert {f: f.read_bytes() for f in ([source] if source.is_file() else source.iterdir())} == before
    recording = Recording.open(target)
    number = recording.measurement["sequence"].astype(float)
    for column, name in enumerate(wire.MEASUREMENT.fields):
        np.testing.assert_array_equal(recording.measurement[name], number + column)
    assert recording.topics == result.messages
    with AnyReader([target]) as reader:
        assert sum(1 for _ in reader.messages()) == sum(result.messages.values())
    for file in target.glob("*.mcap"):
        with file.open("rb") as stream:
            list(make_reader(stream, validate_crcs=True).iter_messages())
    return result, recording


def test_salvage_of_an_intact_recording(tmp_path, whole):
    result, recording = saved(tmp_path, whole)
    assert result.complete
    assert (result.missing, result.lost_at_end, result.broken_off, result.losses, result.notes) == (
        0,
        0.0,
        False,
        (),
        (),
    )
    assert len(recording.measurement) == len(recording.command) == SAMPLES
    assert recording.bench_text == "the bench"
    assert "nothing was missing" in shown(salvage_page(result))
    assert info(tmp_path / "saved").unchecked == 0


@pytest.mark.parametrize("part", [0.1, 0.35, 0.5, 0.77, 0.97])
def test_salvage_of_a_truncated_file(tmp_path, data, part):
    size = int(part * len(data))
    complete = [stop for _, stop in chunks(data) if stop <= size]
    result, recording = saved(tmp_path, broken(tmp_path, data[:size]))
    assert result.broken_off
    assert not result.complete
    assert result.missing is None
    assert recording.integrity().complete
    # at most the chunk that was cut is lost
    assert len(recording.measurement) >= SAMPLES * (len(complete) / len(chunks(data))) - 40
    assert "has no end" in shown(salvage_page(result))
    assert "samples: complete up to where the file breaks off" in shown(salvage_page(result))


def test_time_lost_at_the_end_is_reported_where_known(tmp_path, data):
    start, stop = chunks(data)[20]
    result, recording = saved(tmp_path, broken(tmp_path, data[: stop - 10]))
    (loss,) = result.losses
    assert loss.reason == "a chunk that is cut off"
    assert loss.byte == start
    assert loss.end is not None
    assert result.lost_at_end == pytest.approx(loss.end - recording.duration, abs=1e-9)
    assert 0.0 < result.lost_at_end < 0.05
    assert "ms are missing" in shown(salvage_page(result))


def test_chunk_with_a_wrong_checksum(tmp_path, data):
    start, stop = chunks(data)[5]
    damaged = bytearray(data)
    damaged[stop - 30] ^= 4
    result, recording = saved(tmp_path, broken(tmp_path, damaged))
    (loss,) = result.losses
    assert (loss.reason, loss.byte, loss.size) == ("the checksum of a chunk is wrong", start, stop - start)
    lost = recording.integrity().missing + SAMPLES - len(recording.command)
    assert loss.messages == result.missing == lost
    assert result.integrity == recording.integrity()
    assert recording.integrity().gaps[0][0] * PERIOD_NS * 1e-9 == pytest.approx(
        loss.start, abs=1.5 * PERIOD_NS * 1e-9
    )
    assert not result.broken_off
    assert f"{lost} messages from" in shown(salvage_page(result))
    assert re.search(
        r"samples: \d+ missing \(by sequence number: \d+ from \d+\)", shown(salvage_page(result))
    )


@pytest.mark.parametrize(
    "change",
    [
        "opcode to index",
        "opcode to nothing",
        "length too long",
        "length too short",
        "begin",
        "zeros",
        "random",
        "inserted",
    ],
)
def test_one_damaged_place_costs_one_chunk(tmp_path, data, change):
    start, stop = chunks(data)[7]
    damaged = bytearray(data)
    if change == "opcode to index":
        damaged[start] = 0x0C
    elif change == "opcode to nothing":
        damaged[start] = 0x77
    elif change == "length too long":
        damaged[start + 6] = 1
    elif change == "length too short":
        damaged[start + 1] ^= 64
    elif change == "begin":
        damaged[:8] = b"12345678"
    elif change == "zeros":
        damaged[start : stop - 5] = bytes(stop - 5 - start)
    elif change == "random":
        damaged[start:stop] = np.random.default_rng(1).bytes(stop - start)
    else:
        damaged[start + 40 : start + 40] = b"abcdefgh"
    result, recording = saved(tmp_path, broken(tmp_path, damaged))
    assert not result.complete
    each = SAMPLES / len(chunks(data))
    assert len(recording.measurement) >= SAMPLES - 1.5 * each
    if change != "begin":
        assert len(recording.measurement) < SAMPLES
        assert result.losses


def test_declarations_that_are_lost_with_the_first_chunk_come_from_the_summary(tmp_path, data):
    start, stop = chunks(data)[0]
    damaged = bytearray(data)
    damaged[start:stop] = bytes(stop - start)
    result, recording = saved(tmp_path, broken(tmp_path, damaged))
    assert len(recording.command) > SAMPLES * 0.9
    assert result.messages["/gyrowheel/bench"] == 0


def test_salvage_without_any_message_is_refused(tmp_path, data):
    for name, content in {"empty": b"", "short": data[:100], "noise": bytes(range(256)) * 40}.items():
        with pytest.raises(InputError, match=f"{name}.mcap: holds no message that can be saved"):
            salvage(broken(tmp_path, content, name), tmp_path / "saved")
    assert not (tmp_path / "saved").exists()
    assert sorted(f.suffix for f in tmp_path.iterdir()) == [".mcap"] * 3


def test_other_files_cannot_be_salvaged(tmp_path, whole, data):
    (tmp_path / "nothing").mkdir()
    for source, target, text in [
        (tmp_path / "nowhere", tmp_path / "new", "nowhere: no such file or directory"),
        (tmp_path / "nothing", tmp_path / "new", "nothing: no MCAP file"),
        (whole, whole.parent, "exists; a recording needs a new directory"),
        (whole, whole / "below", "lies in .*, which is not to be touched"),
    ]:
        with pytest.raises(InputError, match=text):
            salvage(source, target)
    (tmp_path / "bag.db3").write_bytes(b"x")
    with pytest.raises(InputError, match="only MCAP files can be salvaged"):
        salvage(tmp_path / "bag.db3", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_recording_in_progress_is_not_salvaged(tmp_path):
    writer = RecordingWriter(tmp_path / "live")
    for topic, stamp, message in messages(50):
        writer.write(topic, message, stamp)
    writer.flush()
    with pytest.raises(InputError, match="live: is being recorded; stop the recorder first"):
        salvage(tmp_path / "live", tmp_path / "saved")
    with pytest.raises(InputError, match="live: another recorder is writing into it"):
        RecordingWriter(tmp_path / "live")
    writer.abort()
    assert salvage(tmp_path / "live", tmp_path / "saved").messages[topics.MEASUREMENT.name] == 50


def test_split_recording_with_a_file_missing(tmp_path):
    with RecordingWriter(tmp_path / "split", max_duration=0.1) as writer:
        for topic, stamp, message in messages():
            writer.write(topic, message, stamp)
    assert len(list((tmp_path / "split").glob("*.mcap"))) == 5
    (tmp_path / "split" / "split_2.mcap").unlink()
    last = tmp_path / "split" / "split_4.mcap"
    last.write_bytes(last.read_bytes()[:-500])
    result, recording = saved(tmp_path, tmp_path / "split")
    assert recording.integrity().gaps == ((400, 200),)
    assert result.missing == 400
    assert any("split_2.mcap is not there" in note for note in result.notes)
    assert any("split_4.mcap" in note for note in result.notes)
    assert len(list((tmp_path / "saved").glob("saved_*.mcap"))) == 4


@pytest.mark.parametrize("named", [True, False])
def test_second_copy_of_a_file(tmp_path, whole, named):
    """A copy beside a recording is left out, whether metadata.yaml says so or the content does."""
    folder = tmp_path / "folder"
    shutil.copytree(whole, folder)
    shutil.copy(folder / "run_0.mcap", folder / "run_0 (copy).mcap")
    if not named:
        (folder / "metadata.yaml").unlink()
    result, recording = saved(tmp_path, folder)
    assert result.complete
    assert len(result.files) == 1
    assert len(result.notes) == 1
    assert "left out" in result.notes[0]
    assert recording.integrity().duplicates == 0
    assert len(recording.measurement) == SAMPLES


def test_every_file_is_salvaged_on_request(tmp_path, whole):
    """With every file the copies are there, told and not counted as whole; reading gives each message once."""
    folder = tmp_path / "folder"
    shutil.copytree(whole, folder)
    shutil.copy(folder / "run_0.mcap", folder / "copy.mcap")
    result = salvage(folder, tmp_path / "saved", every_file=True)
    assert not result.complete
    assert "nothing was missing" not in shown(salvage_page(result))
    recording = Recording.open(tmp_path / "saved")
    assert recording.integrity().duplicates == SAMPLES
    assert len(recording.measurement) == len(recording.command) == SAMPLES


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags_of_others(tmp_path, mode):
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(
            topics.MEASUREMENT.name, topics.MEASUREMENT.type_name, typestore=typestore()
        )
        for topic, stamp, message in messages():
            if topic is topics.MEASUREMENT:
                writer.write(connection, stamp, message)
    result = salvage(tmp_path / "bag", tmp_path / "saved")
    recording = Recording.open(tmp_path / "saved")
    assert recording.measurement["sequence"].tolist() == list(range(SAMPLES))
    assert result.messages == {topics.MEASUREMENT.name: SAMPLES}


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_chunks_of_another_writer_that_are_compressed(tmp_path, compression):
    path = tmp_path / "other.mcap"
    writer = mcap.writer.Writer(str(path), chunk_size=4000, compression=compression)
    writer.start(profile="ros2")
    text = definition(topics.MEASUREMENT.type_name).text
    schema = writer.register_schema(topics.MEASUREMENT.type_name, "ros2msg", text.encode())
    channel = writer.register_channel(topics.MEASUREMENT.name, "cdr", schema)
    for topic, stamp, message in messages():
        if topic is topics.MEASUREMENT:
            writer.add_message(channel, stamp, message, stamp)
    writer.finish()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    result, recording = saved(tmp_path, path)
    assert SAMPLES * 0.3 < len(recording.measurement) < SAMPLES * 0.6
    assert recording.integrity().complete
    assert result.unchecked == 0


def test_long_chunks_of_another_writer_are_divided(tmp_path):
    """What was salvaged loses no more to a damaged place than any other recording, late messages and all."""
    path = tmp_path / "other.mcap"
    writer = mcap.writer.Writer(str(path), chunk_size=1 << 20, compression=CompressionType.ZSTD)
    writer.start(profile="ros2")
    text = definition(topics.MEASUREMENT.type_name).text
    schema = writer.register_schema(topics.MEASUREMENT.type_name, "ros2msg", text.encode())
    channel = writer.register_channel(topics.MEASUREMENT.name, "cdr", schema)
    samples = [(stamp, message) for topic, stamp, message in messages(4000) if topic is topics.MEASUREMENT]
    for k in range(0, 4000, 2):
        samples[k : k + 2] = samples[k : k + 2][::-1]
    for stamp, message in samples:
        writer.add_message(channel, stamp, message, stamp)
    writer.finish()
    result, recording = saved(tmp_path, path)
    assert result.missing == 0
    assert recording.measurement["sequence"].tolist() == list(range(4000))
    with (tmp_path / "saved" / "saved_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    index = summary.chunk_indexes
    assert len(index) == 8
    assert max(chunk.message_end_time - chunk.message_start_time for chunk in index) <= 0.251e9


def test_messages_without_checksums_are_saved_and_counted(tmp_path):
    path = tmp_path / "plain.mcap"
    writer = mcap.writer.Writer(str(path), use_chunking=False, enable_crcs=False)
    writer.start(profile="ros2")
    text = definition(topics.MEASUREMENT.type_name).text
    schema = writer.register_schema(topics.MEASUREMENT.type_name, "ros2msg", text.encode())
    channel = writer.register_channel(topics.MEASUREMENT.name, "cdr", schema)
    for topic, stamp, message in messages(100):
        if topic is topics.MEASUREMENT:
            writer.add_message(channel, stamp, message, stamp)
    writer.finish()
    content = path.read_bytes()
    path.write_bytes(content[:12000])
    result, recording = saved(tmp_path, path)
    assert 50 < len(recording.measurement) < 100
    assert result.unchecked == len(recording.measurement)
    assert "have no checksum" in shown(salvage_page(result))


def test_salvage_on_a_full_disk(tmp_path, whole):
    if os.geteuid() == 0:
        target = Path("/proc/nowhere/saved")
    else:
        (tmp_path / "closed").mkdir(mode=0o500)
        target = tmp_path / "closed" / "saved"
    with pytest.raises(InputError, match="saved: cannot be written: "):
        salvage(whole, target)


def test_salvage_command(tmp_path, data, capsys):
    file = broken(tmp_path, data[: len(data) // 2])
    assert run(app, ["salvage", str(file), "-o", str(tmp_path / "saved"), "--json", "-"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["schema"] == 1
    assert content["broken_off"]
    assert content["messages"]["/gyrowheel/measurement"] > 400
    assert run(app, ["salvage", str(file), "-o", str(tmp_path / "saved")]) == 2
    assert "exists; a recording needs a new directory" in capsys.readouterr().err
    assert run(app, ["salvage", str(file), "-o", str(tmp_path / "other")]) == 0
    assert "has no end" in capsys.readouterr().out
    assert run(app, ["info", str(tmp_path / "other")]) == 0
    shutil.rmtree(tmp_path / "other")
