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
    from gyrowheel.blind_tests.api import open_key
    from gyrowheel.blind_tests.key import Key
    from gyrowheel.calibration.api import calibrate
    from gyrowheel.calibration.result import Calibration
    from gyrowheel.campaigns.api import campaign
    from gyrowheel.campaigns.result import CampaignResult
    from gyrowheel.catalogue.api import benches, effects, own_effect, plans
    from gyrowheel.catalogue.plan_check import check_plan
    from gyrowheel.catalogue.plan_check_result import PlanCheck
    from gyrowheel.comparison.api import compare
    from gyrowheel.comparison.result import Comparison
    from gyrowheel.diagnosis.api import diagnose
    from gyrowheel.diagnosis.result import Diagnosis
    from gyrowheel.drag_comparison.api import drag
    from gyrowheel.drag_comparison.result import Drag
    from gyrowheel.investigation.api import investigate
    from gyrowheel.investigation.result import Investigation
    from gyrowheel.models.addition import Addition
    from gyrowheel.models.api import Model
    from gyrowheel.momentum_envelope.api import momentum
    from gyrowheel.momentum_envelope.result import Momentum
    from gyrowheel.paper_figures.api import paper
    from gyrowheel.paper_figures.result import Paper
    from gyrowheel.rate_sensing.api import rate
    from gyrowheel.rate_sensing.result import Rates
    from gyrowheel.recordings.api import Recording, salvage
    from gyrowheel.recordings.correction import correct
    from gyrowheel.report.api import Report
    from gyrowheel.simulation.api import simulate
    from gyrowheel.tables.api import read_bag, read_table, suggest_map, write_table
    from gyrowheel.tables.table_map import TableMap
    from gyrowheel.torque_budget.api import Torques, torques
    from gyrowheel_core.errors import InputError

__version__ = "0.1.0"

#: Module of every public name.
_HOMES = {
    "Addition": "gyrowheel.models.addition",
    "Calibration": "gyrowheel.calibration.result",
    "CampaignResult": "gyrowheel.campaigns.result",
    "Comparison": "gyrowheel.comparison.result",
    "Diagnosis": "gyrowheel.diagnosis.result",
    "Drag": "gyrowheel.drag_comparison.result",
    "InputError": "gyrowheel_core.errors",
    "Investigation": "gyrowheel.investigation.result",
    "Key": "gyrowheel.blind_tests.key",
    "Model": "gyrowheel.models.api",
    "Momentum": "gyrowheel.momentum_envelope.result",
    "Paper": "gyrowheel.paper_figures.result",
    "PlanCheck": "gyrowheel.catalogue.plan_check_result",
    "Rates": "gyrowheel.rate_sensing.result",
    "Recording": "gyrowheel.recordings.api",
    "Report": "gyrowheel.report.api",
    "TableMap": "gyrowheel.tables.table_map",
    "Torques": "gyrowheel.torque_budget.api",
    "benches": "gyrowheel.catalogue.api",
    "calibrate": "gyrowheel.calibration.api",
    "campaign": "gyrowheel.campaigns.api",
    "check_plan": "gyrowheel.catalogue.plan_check",
    "compare": "gyrowheel.comparison.api",
    "correct": "gyrowheel.recordings.correction",
    "diagnose": "gyrowheel.diagnosis.api",
    "drag": "gyrowheel.drag_comparison.api",
    "effects": "gyrowheel.catalogue.api",
    "investigate": "gyrowheel.investigation.api",
    "momentum": "gyrowheel.momentum_envelope.api",
    "open_key": "gyrowheel.blind_tests.api",
    "own_effect": "gyrowheel.catalogue.api",
    "paper": "gyrowheel.paper_figures.api",
    "plans": "gyrowheel.catalogue.api",
    "rate": "gyrowheel.rate_sensing.api",
    "read_bag": "gyrowheel.tables.api",
    "read_table": "gyrowheel.tables.api",
    "salvage": "gyrowheel.recordings.api",
    "simulate": "gyrowheel.simulation.api",
    "suggest_map": "gyrowheel.tables.api",
    "torques": "gyrowheel.torque_budget.api",
    "write_table": "gyrowheel.tables.api",
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
