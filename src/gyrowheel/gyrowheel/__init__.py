"""Python API of the gyrowheel test bench.

Compare a model with a recording, see where it fails, find the missing physical effect, add it, and see the error
fall::

    import gyrowheel as gw

    check = gw.simulate("check", effects={"windage": {}}, machine=6)
    quick = gw.simulate("quick", effects={"windage": {}}, machine=6)
    model = gw.Model("gyrowheel")
    found = gw.diagnose(quick, model, validate=check)
    better = model.add(found, fit=quick, validate=check)

Recordings are given as `Recording`, as a path, or as a list of either. Results are immutable; they print a page,
show the same page in a notebook, and have ``to_dict()``, ``to_columns()``, ``to_frame()``, ``plot()`` and ``save()``.
Numbers are in SI units. Bad input raises `InputError`, whose message is one line.

Nothing is printed, nothing is written unless asked for, and no global state changes. Importing this module is cheap:
each name is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

with open(f"{__path__[0]}/__init__.pyi", encoding="utf-8") as _stub:
    #: Module of every public name: the lines ``from MODULE import NAME as NAME`` of the stub.
    _HOMES = {line.split()[-1]: line.split()[1] for line in _stub if line.startswith("from ")}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
