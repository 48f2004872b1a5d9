"""The messages of any ROS 2 bag, as they are serialized."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import yaml
from rosbags.interfaces import ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from gyrowheel_analysis.recording.mcap_reader import TopicData, read_mcap
from gyrowheel_analysis.recording.writer import METADATA_FILE
from gyrowheel_sim.errors import InputError

Wanted = Mapping[str, np.dtype[Any] | None]


def read_bag(path: Path, wanted: Wanted) -> dict[str, TopicData]:
    """Read the messages of some topics of a bag, and count those of the others.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, or one ``.mcap`` or ``.db3`` file.
    wanted : mapping of str to dtype or None
        Names of the topics to read; with the dtype of one serialized message where its length is fixed.

    Returns
    -------
    dict of str to TopicData
        All topics by name.

    Raises
    ------
    InputError
        If there is no such bag, or it is incomplete or damaged.
    """
    if path.is_file():
        return _merge(path, read_mcap(path, wanted) if path.suffix == ".mcap" else _read_other(path, wanted))
    if not path.is_dir():
        raise InputError(f"{path}: no such recording")
    file = path / METADATA_FILE
    if not file.is_file():
        begun = any(path.glob("*.mcap")) or any(path.glob("*.db3"))
        what = "the recording was not completed" if begun else "this is no recording"
        raise InputError(f"{path}: no {METADATA_FILE}: {what}")
    files, count, plain = _parse_metadata(file)
    if plain:
        channels = [topic for name in files for topic in read_mcap(path / name, wanted)]
    else:
        channels = _read_other(path, wanted)
    found = sum(topic.count for topic in channels)
    if found != count:
        raise InputError(f"{path}: {METADATA_FILE} counts {count} messages, but the files hold {found}")
    return _merge(path, channels)


def _parse_metadata(file: Path) -> tuple[list[str], int, bool]:
    """Return the names of the files, the number of messages, and whether they are MCAP and not compressed."""
    try:
        metadata = yaml.safe_load(file.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        files = [PurePath(name).name for name in metadata["relative_file_paths"]]
        count = metadata["message_count"]
        mode = str(metadata.get("compression_mode") or "none").lower()
        return files, int(count), metadata["storage_identifier"] == "mcap" and mode == "none"
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    except yaml.YAMLError as error:
        raise InputError(f"{file}: not valid YAML: {_line(error)}") from None
    except KeyError as error:
        raise InputError(f"{file}: {error.args[0]}: missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{file}: not the metadata of a recording ({_line(error)})") from None


def _read_other(path: Path, wanted: Wanted) -> list[TopicData]:
    """Read whatever rosbags can read."""
    encodings = {
        MessageDefinitionFormat.MSG: "ros2msg",
        MessageDefinitionFormat.IDL: "ros2idl",
        MessageDefinitionFormat.NONE: "",
    }
    try:
        with Reader(path) as reader:
            channels: dict[int, TopicData] = {}
            for connection in reader.connections:
                assert isinstance(connection.ext, ConnectionExtRosbag2)
                channels[connection.id] = TopicData(
                    connection.topic,
                    connection.msgtype,
                    connection.ext.serialization_format,
                    encodings[connection.msgdef.format],
                    connection.msgdef.data,
                    connection.msgcount,
                )
            read = [connection for connection in reader.connections if connection.topic in wanted]
            messages: dict[int, list[bytes]] = {connection.id: [] for connection in read}
            times: dict[int, list[int]] = {connection.id: [] for connection in read}
            if read:
                for connection, time, data in reader.messages(read):
                    messages[connection.id].append(bytes(data))
                    times[connection.id].append(time)
    except Exception as error:  # rosbags lets through what its parsers and sqlite3 raise on damaged files
        raise InputError(f"{path}: cannot be read: {_line(error) or type(error).__name__}") from None
    for number, piece in messages.items():
        topic = channels[number]
        if len(piece) != topic.count:
            raise InputError(
                f"{path}: {topic.name} has {len(piece)} messages where {topic.count} are counted"
            )
        topic.pieces.append(piece)
        topic.times.append(np.array(times[number], dtype=np.int64))
    return list(channels.values())


def _merge(path: Path, channels: Iterable[TopicData]) -> dict[str, TopicData]:
    """Join the channels of each topic."""
    merged: dict[str, TopicData] = {}
    for channel in channels:
        topic = merged.setdefault(channel.name, channel)
        if topic is channel:
            continue
        if topic.type_name != channel.type_name or topic.definition != channel.definition:
            raise InputError(f"{path}: {topic.name} has messages of several types")
        topic.count += channel.count
        topic.times += channel.times
        topic.pieces += channel.pieces
    return merged


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
