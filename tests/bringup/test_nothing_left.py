"""What nodes take of the computer: sockets on the loopback alone, and shared memory that goes with them."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gyrowheel_bringup.graph.shared_memory import remove_dead, used_by

from .helpers import Bystander, NodeProcess


def _sockets(pids: list[int]) -> set[tuple[str, str]]:
    """Return kind and local address of the sockets of processes, as `ss -lntup` shows them."""
    inodes = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            try:
                match = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(link))
            except OSError:  # closed in between
                continue
            inodes |= {match[1]} if match else set()
    found = set()
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        file = Path("/proc/net") / kind
        for line in file.read_text().splitlines()[1:] if file.exists() else ():
            local, inode = line.split()[1], line.split()[9]
            if inode in inodes:
                found.add((kind, _address(local.partition(":")[0])))
    return found


def _address(digits: str) -> str:
    words = [int(digits[k : k + 8], 16) for k in range(0, len(digits), 8)]
    packed = struct.pack(f"={len(words)}I", *words)
    return socket.inet_ntop(socket.AF_INET if len(words) == 1 else socket.AF_INET6, packed)


@pytest.mark.graph
def test_nodes_open_the_loopback_alone_and_leave_no_shared_memory(
    domain: int, bystander: Bystander, start_node: Callable[..., NodeProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    from gyrowheel_bringup.foxglove_process import foxglove

    pytest.importorskip("foxglove")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    names = ("plant", "controller", "conductor", "recorder", "drag_estimator")
    nodes = [start_node(name) for name in names]
    with foxglove(0):
        bystander.spin_until(lambda: {*names, "foxglove"} <= set(bystander.diagnoses))
        pids = [int(bystander.values(name)["pid"]) for name in (*names, "foxglove")]
        # and this process, which has a node as that of a starter has
        found = _sockets([*pids, os.getpid()])
    assert {kind for kind, _ in found} >= {"udp", "tcp"}
    assert [place for place in found if not place[1].startswith("127.")] == []

    # killed all at once, they leave their memory behind; the next start removes it
    used = set().union(*(used_by(node.process.pid) for node in nodes))
    for node in nodes:
        node.process.send_signal(signal.SIGKILL)
        node.process.wait()
    shared, hour = Path("/dev/shm"), time.time() - 3600.0
    for name in used:
        for file in shared.glob(f"*{name}*"):
            os.utime(file, (hour, hour))
    removed = set(remove_dead()) & used
    assert len(removed) >= len(nodes)
    assert not [file for name in removed for file in shared.glob(f"*{name}*")]
    # what this process holds stays, and it can be talked to as before
    assert any((shared / name).exists() for name in used - removed)
    again = start_node("controller")
    bystander.diagnoses.clear()
    bystander.spin_until(lambda: bystander.values("controller").get("pid") == str(again.process.pid))


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Path]:
    old = time.time() - 100.0
    for name in (
        *("fastrtps_0123456789abcdef", "fastrtps_0123456789abcdef_el"),
        *("fastrtps_port7411", "fastrtps_port7411_el", "sem.fastrtps_port7411_mutex"),
        *("fastrtps_1111111111111111", "fastrtps_1111111111111111_el"),
        *("fastrtps_port7413", "fastrtps_port7413_sl"),
        *("fastrtps_2222222222222222", "fastrtps_2222222222222222_el"),
        *("fastrtps_mine", "sem.other", "fastrtps_012345678"),
    ):
        (tmp_path / name).touch()
        if "2222" not in name:
            os.utime(tmp_path / name, (old, old))
    (tmp_path / "fastrtps_3333333333333333").symlink_to(tmp_path / "sem.other")
    held = tmp_path / "fastrtps_1111111111111111_el", tmp_path / "fastrtps_port7413_sl"
    with held[0].open("rb") as one, held[1].open("rb") as two:
        fcntl.flock(one, fcntl.LOCK_EX)
        fcntl.flock(two, fcntl.LOCK_SH)
        yield tmp_path


def test_memory_that_somebody_holds_or_that_is_young_or_not_of_the_middleware_stays(place: Path) -> None:
    assert remove_dead(place) == ["fastrtps_0123456789abcdef", "fastrtps_port7411"]
    assert {file.name for file in place.iterdir()} == {
        *("fastrtps_1111111111111111", "fastrtps_1111111111111111_el"),
        *("fastrtps_port7413", "fastrtps_port7413_sl"),
        *("fastrtps_2222222222222222", "fastrtps_2222222222222222_el"),
        *("fastrtps_mine", "sem.other", "fastrtps_012345678", "fastrtps_3333333333333333"),
    }
    assert remove_dead(place / "nowhere") == []
