"""``metadata.yaml``: what is written is read, and what cannot be followed is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gyrowheel_core import topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.bags.metadata import (
    METADATA_FILE,
    BagFile,
    bag_metadata,
    metadata_text,
    qos_profiles,
    read_metadata,
    write_metadata,
)

FILES = [
    BagFile("run_0.mcap", 100, 700, 5),
    BagFile("run_1.mcap", 0, 0, 0),
    BagFile("run_2.mcap", 701, 900, 2),
]


def content(**changes: Any) -> dict[str, Any]:
    topic = {"name": "/t", "type": "std_msgs/msg/String", "offered_qos_profiles": qos_profiles(topics.BENCH)}
    return bag_metadata(FILES, [(topic, 7)], {"key": "text"}) | changes


def test_metadata_round_trip(tmp_path: Path) -> None:
    write_metadata(tmp_path, content())
    found = read_metadata(tmp_path / METADATA_FILE)
    found.require_readable(tmp_path / METADATA_FILE)
    assert found.files == [file.name for file in FILES]
    assert (found.count, found.end) == (7, 900)
    assert (found.storage, found.compression, found.compression_format) == ("mcap", "none", "")
    # an empty file has no times
    stated = read_yaml((tmp_path / METADATA_FILE).read_text(), "")["rosbag2_bagfile_information"]
    assert stated["starting_time"] == {"nanoseconds_since_epoch": 100}
    assert stated["duration"] == {"nanoseconds": 800}
    assert stated["custom_data"] == {"key": "text"}


def test_a_latched_topic_is_stated_as_such() -> None:
    (latched,), (other,) = qos_profiles(topics.BENCH), qos_profiles(topics.MEASUREMENT)
    assert latched["durability"] == "transient_local"
    assert other["durability"] == "volatile"
    assert read_yaml(metadata_text([other]), "") == [other]


@pytest.mark.parametrize("gone", ["starting_time", "duration"])
def test_end_is_unknown_without_times(tmp_path: Path, gone: str) -> None:
    stated = content()
    del stated[gone]
    write_metadata(tmp_path, stated)
    assert read_metadata(tmp_path / METADATA_FILE).end is None


@pytest.mark.parametrize("gone", ["relative_file_paths", "message_count", "storage_identifier"])
def test_missing_metadata_fields_are_named(tmp_path: Path, gone: str) -> None:
    stated = content()
    del stated[gone]
    write_metadata(tmp_path, stated)
    with pytest.raises(InputError, match=rf"{METADATA_FILE}: {gone}: missing$"):
        read_metadata(tmp_path / METADATA_FILE)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"relative_file_paths": ["a.mcap", "old/a.mcap"]}, "relative_file_paths: a file is named twice"),
        ({"compression_mode": "BEST"}, "compression_mode: 'best'; allowed: none, file, message, storage"),
        ({"compression_mode": "FILE", "compression_format": "lz4"}, "compression_format: 'lz4'; only zstd"),
    ],
)
def test_unsupported_metadata_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    write_metadata(tmp_path, content(**changes))
    found = read_metadata(tmp_path / METADATA_FILE)  # salvage makes do with it
    with pytest.raises(InputError) as caught:
        found.require_readable(tmp_path / METADATA_FILE)
    assert said in str(caught.value)


def test_missing_metadata_are_reported_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / METADATA_FILE
    with pytest.raises(InputError, match="cannot be read"):
        read_metadata(file)
    file.write_text("- 1\n- 2\n")
    with pytest.raises(InputError, match="not the metadata of a recording"):
        read_metadata(file)
