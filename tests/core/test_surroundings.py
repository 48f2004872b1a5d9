"""Environment variables that change what the bench does, and settings that lie in the current folder."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.surroundings import VARIABLES, begin, ignored_here, prepare_environment

DOCS = Path(__file__).resolve().parents[2] / "docs" / "environment.md"


@pytest.fixture
def _unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put back what `begin` sets."""
    for name in ("PYTHONSAFEPATH", "MPLBACKEND", "PYTHONWARNINGS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("_unchanged")
@pytest.mark.parametrize("value", ["0", "-1", "many", "1.5", "٣", "9" * 400])
def test_a_variable_with_which_nothing_works_is_refused_at_the_start(
    value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", value)
    with pytest.raises(InputError, match=r"^NUMBA_NUM_THREADS: .* is not allowed; allowed: a whole number"):
        begin()


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ROS_DOMAIN_ID", ["abc", "-1", "233", "9" * 400, "٣", "1.0"]),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", ["OFF", "localhost", "NOT_SET", "x"]),
        ("RMW_IMPLEMENTATION", ["rmw_none_cpp", "../rmw_typesupport/rmw_fastrtps_cpp"]),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", ["/none", "/"]),
        ("ROS_SECURITY_ENABLE", ["true"]),
    ],
)
def test_a_variable_with_which_ros_does_not_work_is_refused(
    name: str, values: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The middleware would end the process with the exit code of a finding, or wait for ever."""
    monkeypatch.delenv("ROS_SECURITY_KEYSTORE", raising=False)
    for value in values:
        monkeypatch.setenv(name, value)
        with pytest.raises(InputError, match=rf"^{name}: .* is not allowed; allowed: "):
            prepare_environment()


def test_a_missing_middleware_is_refused_before_it_is_loaded(tmp_path: Path) -> None:
    """The library of ROS ends the process that imports it."""
    for module in ("import gyrowheel_bringup.graph", "import sys; sys.argv[1:] = ['gyrowheel_sim.plant.node']; "
                   "from gyrowheel_core.start_node import main; sys.exit(main())"):  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-P", "-c", module],
            env=os.environ | {"RMW_IMPLEMENTATION": "rmw_none_cpp"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode in (1, 2)  # a traceback for an import of one's own
        assert done.stderr.strip().endswith(
            "RMW_IMPLEMENTATION: 'rmw_none_cpp' is not allowed; allowed: one that is installed, such as "
            "rmw_fastrtps_cpp"
        )


@pytest.mark.usefixtures("_unchanged")
def test_warnings_of_libraries_end_no_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        begin()
        warnings.warn("old", DeprecationWarning, stacklevel=1)
    assert "PYTHONWARNINGS" not in os.environ  # of child processes


@pytest.mark.usefixtures("_unchanged")
def test_settings_of_the_current_folder_are_found_in_processes_of_others_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("settings").touch()
    if not sys.flags.safe_path:
        with ignored_here("settings") as ignored:
            assert not ignored
            assert os.path.exists("settings")
    monkeypatch.setenv("PYTHONSAFEPATH", "1")
    with ignored_here("settings") as ignored:
        assert ignored
        assert not os.path.exists("settings")
        assert os.path.exists(tmp_path / "settings")
    assert os.path.exists("settings")


def test_every_variable_is_described() -> None:
    page = DOCS.read_text(encoding="utf-8")
    assert [own.name for own in VARIABLES if f"`{own.name}`" not in page] == []
