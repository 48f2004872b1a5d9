"""Files and folders on their way to a path: whole or not there, whenever their process is killed; nothing beside."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from gyrowheel_core.files import new_directory, new_file, temporary_path, write_bytes

#: A process that forks one that writes for ever, at every line that it reads, and says its number.
_WRITES = """
    import os, sys
    from itertools import cycle
    from pathlib import Path
    from gyrowheel_core.files import new_directory, write_bytes

    path, folder = Path(sys.argv[1]), sys.argv[2] == "folder"
    for _ in sys.stdin:
        child = os.fork()
        if child:
            print(child, flush=True)
            os.waitpid(child, 0)
            print("ended", flush=True)
            continue
        for letter in cycle("ab"):
            content = letter.encode() * 300_000
            if not folder:
                write_bytes(path, content)
                continue
            for file in path.glob("*"):
                file.unlink()
            with new_directory(path) as place:
                place.mkdir()
                for name in "123":
                    (place / name).write_bytes(content)
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_killed_at_any_instant(kind: str, tmp_path: Path) -> None:
    """Thirty times: what is at the path is whole, and in the end nothing is beside it."""
    path = tmp_path / "target"
    if kind == "file":
        write_bytes(path, b"a" * 300_000)
    draw = random.Random(4)
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(_WRITES), str(path), kind],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    for _ in range(30):
        process.stdin.write("go\n")
        process.stdin.flush()
        child = int(process.stdout.readline())
        time.sleep(draw.uniform(0.002, 0.02))
        os.kill(child, signal.SIGKILL)
        assert process.stdout.readline() == "ended\n"
        files = [path] if kind == "file" else sorted(path.glob("*"))
        contents = {file.read_bytes() for file in files}
        assert contents <= {b"a" * 300_000, b"b" * 300_000}
        if kind == "folder":  # the child empties it, one file after the other, before it makes the next one
            assert len(contents) <= 1
    process.stdin.close()
    assert process.wait(240) == 0
    if kind == "file":
        write_bytes(path, b"done")
    else:
        for file in path.glob("*"):
            file.unlink()
        with new_directory(path) as place:
            place.mkdir()
    assert [place.name for place in tmp_path.iterdir()] == ["target"]


#: A process that stops half way to a file or a folder, and says so.
_STOPS_HALF_WAY = """
    import sys, time
    from pathlib import Path
    from gyrowheel_core.files import new_directory, new_file

    path, folder = Path(sys.argv[1]), sys.argv[2] == "folder"
    with (new_directory if folder else new_file)(path) as place:
        if folder:
            place.mkdir()
        (place / "1" if folder else place).write_bytes(b"a" * 300_000)
        print("half way", flush=True)
        time.sleep(600)
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_remains_of_a_killed_process_are_removed(kind: str, tmp_path: Path) -> None:
    """Nothing is at the path, what is beside it goes when the path is written the next time."""
    path = tmp_path / "target"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(_STOPS_HALF_WAY), str(path), kind],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "half way\n"
    process.kill()
    process.wait(240)
    process.stdout.close()
    assert not path.exists()
    assert len(list(tmp_path.iterdir())) == 1
    if kind == "file":
        write_bytes(path, b"done")
    else:
        with new_directory(path) as place:
            place.mkdir()
    assert list(tmp_path.iterdir()) == [path]


def test_unfinished_files_of_a_running_process_are_kept(tmp_path: Path) -> None:
    """Two at once do not take each other's for left behind, nor a file of the user that is called alike."""
    path = tmp_path / "a.yaml"
    others = [tmp_path / ".a.yaml.0123", tmp_path / ".a.yaml.0123456789ag", tmp_path / ".b.yaml.0123456789ab"]
    for other in others:
        other.write_text("x")
    with temporary_path(path) as (first, _):
        first.write_text("first")
        write_bytes(path, b"second")
        assert first.read_text() == "first"
        with new_file(path) as place:
            assert first.exists()
            place.write_text("third")
    assert path.read_text() == "third"
    assert sorted(tmp_path.iterdir()) == sorted([*others, path])
    (tmp_path / ".a.yaml.0123456789ab").write_text("left behind")
    write_bytes(path, b"fourth")
    assert sorted(tmp_path.iterdir()) == sorted([*others, path])
