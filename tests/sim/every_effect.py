"""Every effect that there is: registered, for blind tests, and the forms of what is unknown."""

from __future__ import annotations

import pytest

from gyrowheel_analysis.diagnosis.free_forms import forms, further_forms, memory_forms
from gyrowheel_sim.effects import Effect, registry
from gyrowheel_sim.plant.scenario import UNREGISTERED

_FORMS = [t.effect for t in (*forms(), *further_forms(), *memory_forms()) if t.effect is not None]
#: Forms that differ only in the values with which a fit begins are one.
EVERY: list[Effect] = [
    *registry().values(),
    *UNREGISTERED,
    *{effect.formula: effect for effect in _FORMS}.values(),
]
EACH = pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.name)
