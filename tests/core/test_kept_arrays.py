"""Arrays in the cache on disk, and the name of the code that computed them."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_core import cache


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    place = tmp_path / "cache"
    monkeypatch.setenv(cache.VARIABLE, str(place))
    yield place
    cache._folder.cache_clear()


def test_arrays_come_back_as_they_were_kept(folder: Path) -> None:
    given = {"z": np.arange(6).reshape(2, 3) * 1j, "empty": np.zeros((0, 4)), "nan": np.array([np.nan, 1.0])}
    assert cache.read_arrays("entry") is None
    cache.write_arrays("entry", **given)
    found = cache.read_arrays("entry")
    assert found is not None
    assert found.keys() == given.keys()
    for name, array in given.items():
        assert found[name].dtype == array.dtype
        assert found[name].tobytes() == array.tobytes()


def test_an_entry_that_is_no_arrays_is_missing(folder: Path) -> None:
    for content in (b"", b"text", b"PK\x03\x04 half an archive", b"\x93NUMPY"):
        cache.write("entry", content)
        assert cache.read_arrays("entry") is None
    cache.write_arrays("entry", objects=np.array([{}], dtype=object))  # would be unpickled
    assert cache.read_arrays("entry") is None


def test_another_line_of_code_gives_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "kept_for_a_test"
    package.mkdir()
    (package / "__init__.py").write_text("")
    module = package / "module.py"
    module.write_text("x = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, package.name, raising=False)

    def name() -> str:
        cache.files_of.cache_clear()
        return cache.files_of(package.name)

    first = name()
    assert name() == first
    module.write_text("x = 2\n")
    second = name()
    module.rename(package / "other.py")
    assert len({first, second, name()}) == 3
