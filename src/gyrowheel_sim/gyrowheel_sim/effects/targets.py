"""The table of law targets: everything that a law can act on.

A target is declared once, by its entry in `TARGETS`. It enters the equations at one of the following places, which the
compiled plant and the torque balance both implement:

==================  ==========================================================================================
place               what is added there
==================  ==========================================================================================
``across``          torque on the rotor across its spin axis, T_x + i T_y in case axes [N m]
``along``           torque on the rotor along its spin axis [N m]
``shaft``           torque on the motor shaft [N m]
``flexure``         torque of each flexure on its joint [N m]
``case_rate``       rate of the case about its x and y axes [rad/s]
``mirror``          part of the coils' torque that is mirrored
``coil_lag``        time constant with which the coils' torque follows their voltage [s]
``offset``          change of a bench parameter, one of `PARAMETERS`, named by `Entry.of`
``relative``        relative change of such a parameter, after its offset
``reading``         error of a reading, one of `READINGS`, named by `Entry.of`; ``tilt`` takes x + i y
==================  ==========================================================================================

A new target that enters at such a place needs its entry here and nothing else: simulation, torque balance, formulas,
units, help and documentation follow from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gyrowheel_sim.parameter import INSTRUMENTS

Place = Literal[
    "across", "along", "shaft", "flexure", "case_rate", "mirror", "coil_lag", "relative", "offset", "reading"
]
#: Places that take a complex number, x + i y.
COMPLEX_PLACES = frozenset(("across", "case_rate", "mirror"))
#: Bench parameters that act as a torque, in proportion to their values.
TORQUE_PARAMETERS = (
    "flexure_stiffness_x", "flexure_stiffness_y", "flexure_damping_x", "flexure_damping_y", "bearing_coulomb",
    "bearing_viscous", "fixed_torque_x", "fixed_torque_y",
)  # fmt: skip
#: Moments of inertia, in the order in which the inverse dynamics takes them; laws that change them are constant.
INERTIAS = (
    "rotor_inertia_x", "rotor_inertia_y", "rotor_inertia_z", "gimbal_inertia_x", "gimbal_inertia_y",
    "gimbal_inertia_z", "shaft_inertia",
)  # fmt: skip
#: Bench parameters of the instruments that a law can change; such laws are constant.
INSTRUMENT_PARAMETERS = tuple(
    name
    for name in INSTRUMENTS
    if name.endswith(("_delay", "_filter_time")) or name.startswith(("encoder_", "tilt_c"))
)
#: Bench parameters that a law can change.
PARAMETERS = (
    *TORQUE_PARAMETERS, *INERTIAS, "coil_constant", "motor_constant", "motor_resistance", "supply_voltage",
    *INSTRUMENT_PARAMETERS,
)  # fmt: skip
#: Readings to which a law can add an error.
READINGS = ("tilt", "coil_voltage_x", "coil_voltage_y", "motor_voltage", "motor_current")
#: Places that are torques.
TORQUE_PLACES = frozenset(("across", "along", "shaft", "flexure"))


@dataclass(frozen=True)
class Entry:
    """The place at which a target enters the equations."""

    place: Place  # one of the places above
    of: str = ""  # bench parameter (``relative``, ``offset``) or reading (``reading``) that is changed
    negative: bool = False  # whether the output of the laws is subtracted there
    over: str = ""  # bench parameter by which it is divided before; empty for none


@dataclass(frozen=True)
class LawTarget:
    """Something that a law can act on."""

    name: str  # name, as in formulas
    unit: str  # unit of the law [SI]
    words: str  # the name in a few words
    sentence: str  # what it means
    #: Size of a noticeable change; usual sizes of user-defined coefficients follow from it.
    noticeable: tuple[float, float]
    enters: tuple[Entry, ...]  # where it enters the equations
    complex: bool = False  # whether a law gives x + i y in case axes
    #: Whether the simulation evaluates its laws once a sample and holds what they give, instead of at every
    #: instant.
    once_a_sample: bool = False

    def __post_init__(self) -> None:
        """Refuse an entry that contradicts itself."""
        for entry in self.enters:
            known = {"relative": PARAMETERS, "offset": PARAMETERS, "reading": READINGS}.get(
                entry.place, ("",)
            )
            if entry.of not in known:
                raise ValueError(
                    f"target {self.name}: {entry.place} of {entry.of!r}; allowed: {', '.join(known) or 'none'}"
                )
            two = entry.place in COMPLEX_PLACES or (entry.place, entry.of) == ("reading", "tilt")
            if two != self.complex:
                raise ValueError(
                    f"target {self.name}: {entry.place} takes {'complex' if two else 'real'} laws"
                )
            if (entry.place in ("coil_lag", "reading")) > self.once_a_sample or (
                self.once_a_sample and entry.place not in ("coil_lag", "reading", "relative", "offset")
            ):
                raise ValueError(f"target {self.name}: {entry.place} is evaluated at the other time")

    @property
    def each_flexure(self) -> bool:
        """Whether a law is written once for both flexures, by the flexure's own angle and rate."""
        return any(entry.place == "flexure" for entry in self.enters)

    @property
    def slow(self) -> bool:
        """Whether it changes the mechanics or an instrument, so that its laws cannot follow tilt and coil voltages."""
        changed = (*INERTIAS, *INSTRUMENT_PARAMETERS)
        return any(entry.place == "case_rate" or entry.of in changed for entry in self.enters)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs of the compiled laws."""
        return (f"{self.name}_x", f"{self.name}_y") if self.complex or self.each_flexure else (self.name,)

    def changes(self, *places: Place) -> bool:
        """Whether it enters at one of some places."""
        return any(entry.place in places for entry in self.enters)


def _instrument(parameter: str, unit: str, words: str, noticeable: tuple[float, float]) -> LawTarget:
    """Return the target of laws that change a parameter of an instrument; it is named as the parameter."""
    return LawTarget(
        parameter, unit, words, f"added to the {words} that the bench file states; constant",
        noticeable, (Entry("offset", parameter),), once_a_sample=True,
    )  # fmt: skip


_ALL = (
    LawTarget(
        "rotor_torque", "N*m", "torque on the rotor",
        "torque on the rotor across its spin axis, T_x + i T_y in case axes",
        (1e-4, 2e-3), (Entry("across"),), complex=True,
    ),
    LawTarget(
        "axial_torque", "N*m", "torque along the spin axis", "torque on the rotor along its spin axis",
        (5e-5, 1e-3), (Entry("along"),),
    ),
    LawTarget(
        "shaft_torque", "N*m", "torque on the shaft", "torque on the motor shaft",
        (5e-5, 1e-3), (Entry("shaft"),),
    ),
    LawTarget(
        "flexure_torque", "N*m", "torque of each flexure",
        "torque of each flexure on its joint, by the flexure's own angle and rate",
        (1e-4, 2e-3), (Entry("flexure"),),
    ),
    LawTarget(
        "inertia_difference", "kg*m^2", "difference of the moments of inertia",
        "added to the rotor's moment of inertia about its x axis and taken from that about y; constant",
        (5e-7, 5e-6), (Entry("offset", "rotor_inertia_x"), Entry("offset", "rotor_inertia_y", negative=True)),
    ),
    LawTarget(
        "case_rate", "rad/s", "rate of the case",
        "rate at which the case itself turns about its x and y axes, x + i y; slow",
        (2e-5, 6e-5), (Entry("case_rate"),), complex=True,
    ),
    LawTarget(
        "coil_gain", "1", "relative change of the torque per volt",
        "relative change of the torque per volt of the coils",
        (0.005, 0.1), (Entry("relative", "coil_constant"),),
    ),
    LawTarget(
        "coil_anisotropy", "1", "mirrored part of the torque of the coils",
        "part a of the coils' torque that is mirrored, T = k (V + a conj(V)): the two axes differ",
        (0.01, 0.05), (Entry("mirror"),), complex=True,
    ),
    LawTarget(
        "coil_lag", "s", "lag of the coils",
        "time constant with which the coils' torque follows their voltage; constant",
        (1e-4, 5e-4), (Entry("coil_lag"),), once_a_sample=True,
    ),
    LawTarget(
        "motor_gain", "1", "relative change of the motor constant",
        "relative change of the motor's constant, torque and back-EMF alike",
        (0.002, 0.02), (Entry("relative", "motor_constant"),),
    ),
    LawTarget(
        "winding_resistance", "1", "relative change of the winding resistance",
        "relative change of the resistance of the motor's winding",
        (0.01, 0.1), (Entry("relative", "motor_resistance"),),
    ),
    LawTarget(
        "supply_drop", "V", "drop of the supply voltage",
        "drop of the supply voltage: lowers the largest motor voltage, and the coils' torque in proportion",
        (0.1, 2.0),
        (
            Entry("offset", "supply_voltage", negative=True),
            Entry("relative", "coil_constant", negative=True, over="supply_voltage"),
        ),
        once_a_sample=True,
    ),
    LawTarget(
        "tilt_reading", "rad", "error of the tilt reading", "added to the tilt readings, x + i y",
        (3e-4, 6e-3), (Entry("reading", "tilt"),), complex=True, once_a_sample=True,
    ),
    *(
        _instrument(f"{channel}_delay", "s", f"delay of {words}", (1e-4, 5e-4))
        for channel, words in (
            ("tilt", "the tilt readings"), ("spin_angle", "the angle reading"),
            ("coil_voltage", "the coil voltages' readings"), ("motor_voltage", "the motor voltage's reading"),
            ("motor_current", "the motor current's reading"),
        )
    ),
    *(
        _instrument(f"{channel}_filter_time", "s", f"time constant of the filter of {words}", (1e-4, 5e-4))
        for channel, words in (
            ("tilt", "the tilt readings"), ("coil_voltage", "the coil voltages' readings"),
            ("motor_voltage", "the motor voltage's reading"), ("motor_current", "the motor current's reading"),
        )
    ),
    _instrument("encoder_zero", "rad", "zero error of the encoder", (0.01, 0.05)),
    *(
        _instrument(f"encoder_{times}_{part}", "rad", f"{of} part of the encoder's error {times} a turn", (1e-3, 1e-2))
        for times in ("once", "twice")
        for part, of in (("x", "cosine"), ("y", "sine"))
    ),
    _instrument("tilt_cubic", "1/rad^2", "non-linearity of the tilt sensors", (0.5, 5.0)),
    _instrument("tilt_cross_talk", "1", "cross-talk of the tilt sensors", (0.005, 0.03)),
)  # fmt: skip
#: Every target by its name, in the order in which they are shown.
TARGETS: Mapping[str, LawTarget] = {target.name: target for target in _ALL}
#: Outputs in the state of the plant of the laws that are evaluated once a sample, in order.
HELD_OUTPUTS = tuple(output for target in _ALL if target.once_a_sample for output in target.outputs)


#: Targets by place, precomputed: a fit looks them up many thousand times.
_ENTERING: dict[tuple[str, str], tuple[tuple[LawTarget, Entry], ...]] = {
    at: tuple(
        (target, entry)
        for target in TARGETS.values()
        for entry in target.enters
        if (entry.place, entry.of) == at
    )
    for at in {(entry.place, entry.of) for target in TARGETS.values() for entry in target.enters}
}


def entering(place: Place, of: str = "") -> tuple[tuple[LawTarget, Entry], ...]:
    """Return the targets that enter at a place, each with its entry there."""
    return _ENTERING.get((place, of), ())


def added(
    laws: Mapping[str, Any], values: Mapping[str, Any], place: Place, of: str = "", start: Any = 0.0
) -> Any:
    """Return `start` with what the laws add to it at a place.

    Parameters
    ----------
    laws : mapping
        Sum of the laws of every target by its name, numbers or arrays; of a target that is missing, zero.
    values : mapping
        Bench parameters by name [SI].
    place, of : str
        The place (see `Entry`).
    start : number or array
        What is there without laws.
    """
    for target, entry in _ENTERING.get((place, of), ()):
        if target.name in laws:
            value = laws[target.name]
            value = value / values[entry.over] if entry.over else value
            start = start - value if entry.negative else start + value
    return start


def changed(laws: Mapping[str, Any], values: Mapping[str, Any], name: str) -> Any:
    """Return a bench parameter as the laws change it; see `added`."""
    value = added(laws, values, "offset", name, start=values[name])
    return value * added(laws, values, "relative", name, start=1.0)
