"""The compiled module of the plant: laws of the effects, equations of motion, instruments and kernel in one source."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

from gyrowheel_sim.columns import Column, source
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.law_code import cached_laws_source, entries_source
from gyrowheel_sim.instruments.readings import (
    FILTERS,
    N_FILTER,
    N_ROWS,
    ROWS,
    WIDTH,
    Chain,
    Drift,
    Past,
    Reading,
)
from gyrowheel_sim.jit import compile_source, kernel_text
from gyrowheel_sim.plant.state import (
    DRIFT_START,
    HELD_START,
    MEMORY_START,
    PlantParameters,
    State,
    Surroundings,
)

_TEMPLATE = """\
# ---- indices into the arrays, and their blocks
{indices}
DRIFT_START, MEMORY_START = {drift_start}, {memory_start}
N_ROWS, N_FILTER, FILTERS, ROWS, WIDTH = {memory_sizes}

# ---- equations of motion
{mechanics}
# ---- inputs and outputs of the laws of the effects
{law_interface}
# ---- the laws, generated from the declarations
{laws}
# ---- the places at which the laws enter the kernels, generated from the law targets
{law_entries}
# ---- instruments
{instruments}
# ---- plant
{plant}
# ---- further kernels
{further}
"""


def compiled_plant(
    effects: Sequence[Effect], extra: Sequence[tuple[str, str]] = (), layouts: Sequence[type[Column]] = ()
) -> ModuleType:
    """Return the compiled module of the plant with these effects; cached on disk by content.

    Parameters
    ----------
    effects : sequence of Effect
        Effects whose laws are compiled in; each acts only where its flag is set.
    extra : sequence of (package, file name)
        Further kernel files that are appended (a controller, a closed loop); see `gyrowheel_sim.jit`.
    layouts : sequence of Column
        Array indices that those files use.
    """
    indices: tuple[type[Column], ...] = (State, Surroundings, Reading, Drift, Past, Chain, *layouts)
    text = _TEMPLATE.format(
        indices="\n".join(map(source, indices)),
        drift_start=DRIFT_START,
        memory_start=MEMORY_START,
        memory_sizes=(N_ROWS, N_FILTER, FILTERS, ROWS, WIDTH),
        mechanics=kernel_text("gyrowheel_sim", "mechanics/dynamics.py"),
        law_interface=kernel_text("gyrowheel_sim", "effects/law_code.py"),
        laws=cached_laws_source(tuple(effects)),
        law_entries=entries_source(PlantParameters._fields, HELD_START),
        instruments=kernel_text("gyrowheel_sim", "instruments/kernel.py"),
        plant=kernel_text("gyrowheel_sim", "plant/kernel.py"),
        further="\n".join(kernel_text(package, name) for package, name in extra),
    )
    return compile_source(text, "the laws of the effects and the kernels of the bench")
