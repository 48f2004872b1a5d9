"""Settings of all tests."""

from __future__ import annotations

import gc
import os
import signal

import pytest
from hypothesis import HealthCheck, settings

# A shell that runs the tests in the background has them ignore these, and every process that they start with them.
for _number, _handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGQUIT, signal.SIG_DFL)):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _handler)

# Before numpy is imported: threads that wait for small matrices take the processor from the other tests.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Hundreds of processes import the same modules: they need not be compiled in each.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# The same examples every time, on a fast machine and on a slow one; `make fuzz` draws new ones.
settings.register_profile(
    "same", derandomize=True, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same")


# What the modules of the tests make stays to the end: it is not searched for garbage again and again.
gc.disable()
gc.set_threshold(20_000)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of ``make studies``, which runs further cases of what the tests show."""
    parser.addoption("--studies", action="store_true", help="run the studies, and nothing else")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    asked = bool(config.getoption("--studies", default=False))
    kept: list[pytest.Item] = []
    left_out: list[pytest.Item] = []
    for item in items:
        is_study = item.get_closest_marker("study") is not None
        (kept if is_study == asked else left_out).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = kept


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
