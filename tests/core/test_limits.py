"""Limits before memory: what a file may grow to."""

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE, largest_unpacked, require_room
from gyrowheel_core.yaml_text import read_yaml


def test_an_oversized_file_is_refused_with_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the file, what it needs, what is allowed, and what raises the limit."""
    require_room(1e9, "signals.mcap: it")
    monkeypatch.setenv(LARGEST_VARIABLE, "0.5")
    with pytest.raises(InputError) as refused:
        require_room(1e9, "signals.mcap: it")
    assert str(refused.value) == (
        "signals.mcap: it needs 1 GB of memory; allowed: 0.5 GB (GYROWHEEL_LARGEST_GB raises the limit)"
    )
    monkeypatch.setenv(LARGEST_VARIABLE, "2")
    require_room(1e9, "signals.mcap: it")


@pytest.mark.parametrize("given", ["x", "-1", "0", "nan", "inf"])
def test_an_invalid_limit_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit that is no number above zero is refused, not ignored."""
    monkeypatch.setenv(LARGEST_VARIABLE, given)
    with pytest.raises(InputError, match="a number of gigabytes above 0"):
        largest_unpacked()


def test_long_yaml_is_refused_at_once() -> None:
    """Ten million characters are refused before they are parsed."""
    with pytest.raises(InputError, match="allowed: up to 1000000"):
        read_yaml("- 1\n" * 2_500_000, "metadata.yaml")
