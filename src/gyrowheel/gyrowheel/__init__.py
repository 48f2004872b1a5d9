"""Python API of the gyrowheel test bench.

Compare a model with a recording, see where it fails, find the missing physical effect, add it, and see the error
fall::

    import gyrowheel as gw

    check = gw.simulate("check", effects={"windage": {}}, machine=6)
    quick = gw.simulate("quick", effects={"windage": {}}, machine=6)
    model = gw.Model("gyrowheel")
    found = gw.diagnose(quick, model, validate=check)
    better = model.add(found, fit=quick, validate=check)

Recordings are given as `Recording`, as a path, or as a list of either. Results are immutable; they print a short text,
show themselves in a notebook, and have ``to_dict()``, ``to_columns()``, ``to_frame()``, ``plot()`` and ``save()``.
Numbers are in SI units. Bad input raises `InputError`, whose message is one line.

Nothing is printed, nothing is written unless asked for, and no global state changes. Importing this module is cheap:
each name is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gyrowheel.analysis import calibrate, compare, diagnose, rate
    from gyrowheel.campaigns.run import campaign
    from gyrowheel.catalogue import benches, effects, own_effect, plans
    from gyrowheel.correcting import correct
    from gyrowheel.envelope import momentum
    from gyrowheel.estimating import drag
    from gyrowheel.holding import torques
    from gyrowheel.investigator import investigate
    from gyrowheel.model import Model
    from gyrowheel.planning import check_plan
    from gyrowheel.publication.run import paper
    from gyrowheel.recording import Recording, salvage
    from gyrowheel.report.report import Report
    from gyrowheel.results.addition import Addition
    from gyrowheel.results.calibration import Calibration
    from gyrowheel.results.campaign import CampaignResult
    from gyrowheel.results.comparison import Comparison
    from gyrowheel.results.diagnosis import Diagnosis
    from gyrowheel.results.drag import Drag
    from gyrowheel.results.investigation import Investigation
    from gyrowheel.results.key import Key
    from gyrowheel.results.momentum import Momentum
    from gyrowheel.results.paper import Paper
    from gyrowheel.results.plan_check import PlanCheck
    from gyrowheel.results.rates import Rates
    from gyrowheel.results.suggestion import TableMap
    from gyrowheel.results.torques import Torques
    from gyrowheel.sealed_key import open_key
    from gyrowheel.simulation import simulate
    from gyrowheel.tables import read_bag, read_table, suggest_map, write_table
    from gyrowheel_core.errors import InputError

__version__ = "0.1.0"

#: Module of every public name.
_HOMES = {
    "Addition": "gyrowheel.results.addition",
    "Calibration": "gyrowheel.results.calibration",
    "CampaignResult": "gyrowheel.results.campaign",
    "Comparison": "gyrowheel.results.comparison",
    "Diagnosis": "gyrowheel.results.diagnosis",
    "Drag": "gyrowheel.results.drag",
    "InputError": "gyrowheel_core.errors",
    "Investigation": "gyrowheel.results.investigation",
    "Key": "gyrowheel.results.key",
    "Model": "gyrowheel.model",
    "Momentum": "gyrowheel.results.momentum",
    "Paper": "gyrowheel.results.paper",
    "PlanCheck": "gyrowheel.results.plan_check",
    "Rates": "gyrowheel.results.rates",
    "Recording": "gyrowheel.recording",
    "Report": "gyrowheel.report.report",
    "TableMap": "gyrowheel.results.suggestion",
    "Torques": "gyrowheel.results.torques",
    "benches": "gyrowheel.catalogue",
    "calibrate": "gyrowheel.analysis",
    "campaign": "gyrowheel.campaigns.run",
    "check_plan": "gyrowheel.planning",
    "compare": "gyrowheel.analysis",
    "correct": "gyrowheel.correcting",
    "diagnose": "gyrowheel.analysis",
    "drag": "gyrowheel.estimating",
    "effects": "gyrowheel.catalogue",
    "investigate": "gyrowheel.investigator",
    "momentum": "gyrowheel.envelope",
    "open_key": "gyrowheel.sealed_key",
    "own_effect": "gyrowheel.catalogue",
    "paper": "gyrowheel.publication.run",
    "plans": "gyrowheel.catalogue",
    "rate": "gyrowheel.analysis",
    "read_bag": "gyrowheel.tables",
    "read_table": "gyrowheel.tables",
    "salvage": "gyrowheel.recording",
    "simulate": "gyrowheel.simulation",
    "suggest_map": "gyrowheel.tables",
    "torques": "gyrowheel.holding",
    "write_table": "gyrowheel.tables",
}

__all__ = [
    "Addition",
    "Calibration",
    "CampaignResult",
    "Comparison",
    "Diagnosis",
    "Drag",
    "InputError",
    "Investigation",
    "Key",
    "Model",
    "Momentum",
    "Paper",
    "PlanCheck",
    "Rates",
    "Recording",
    "Report",
    "TableMap",
    "Torques",
    "__version__",
    "benches",
    "calibrate",
    "campaign",
    "check_plan",
    "compare",
    "correct",
    "diagnose",
    "drag",
    "effects",
    "investigate",
    "momentum",
    "open_key",
    "own_effect",
    "paper",
    "plans",
    "rate",
    "read_bag",
    "read_table",
    "salvage",
    "simulate",
    "suggest_map",
    "torques",
    "write_table",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
