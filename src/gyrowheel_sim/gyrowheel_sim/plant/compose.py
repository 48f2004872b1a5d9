"""The compiled module of the plant: laws of the effects, equations of motion, instruments and kernel in one source."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

from gyrowheel_sim import columns
from gyrowheel_sim.compiled import compile_source, kernel_text
from gyrowheel_sim.effects.code import cached_laws_source, entries_source
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.instruments import memory
from gyrowheel_sim.instruments.readings import Drift, Reading
from gyrowheel_sim.plant.parameters import PlantParameters
from gyrowheel_sim.plant.state import DRIFT_START, HELD_START, MEMORY_START, State, Surroundings

_OWN = "gyrowheel_sim"


def compose(
    effects: Sequence[Effect],
    extra: Sequence[tuple[str, str]] = (),
    layouts: Sequence[type[columns.Column]] = (),
) -> ModuleType:
    """Return the compiled module of the plant with these effects; cached on disk by content.

    Parameters
    ----------
    effects : sequence of Effect
        Effects whose laws are compiled in; each acts only where its flag is set.
    extra : sequence of (package, file name)
        Further kernel files that are appended (a controller, a closed loop); see `gyrowheel_sim.compiled`.
    layouts : sequence of Column
        Places of arrays that those files name.
    """
    every: tuple[type[columns.Column], ...] = (
        State, Surroundings, Reading, Drift, memory.Past, memory.Chain, *layouts,
    )  # fmt: skip
    parts = [
        *(columns.source(layout) for layout in every),
        f"DRIFT_START = {DRIFT_START}\nMEMORY_START = {MEMORY_START}\n",
        "".join(
            f"{name} = {getattr(memory, name)}\n"
            for name in ("N_ROWS", "N_FILTER", "FILTERS", "ROWS", "WIDTH")
        ),
        kernel_text(_OWN, "mechanics/dynamics.py"),
        kernel_text(_OWN, "effects/instant.py"),
        cached_laws_source(tuple(effects)),
        entries_source(PlantParameters._fields, HELD_START),
        kernel_text(_OWN, "instruments/kernel.py"),
        kernel_text(_OWN, "instruments/chain.py"),
        kernel_text(_OWN, "plant/kernel.py"),
        *(kernel_text(package, name) for package, name in extra),
    ]
    return compile_source(parts, "the laws of the effects and the kernels of the bench")
