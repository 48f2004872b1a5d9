"""Wrong setups of recordings, and their corrections."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gyrowheel.show.sentences.findings import every
from gyrowheel_core.quantities import listed, quantity, with_error

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.estimates import Misstated
    from gyrowheel_recording.mislabelled import Fix, WrongSetup

_SPIN = ("spin_angle", "spin_rate", "motor_voltage", "motor_current")
_COILS = {"coil_voltage_x", "coil_voltage_y"}
#: The unit of a reading that is not in SI units.
_UNITS = {
    "deg": "in degrees, not in radians",
    "turns": "in turns, not in radians",
    "mrad": "in mrad, not in radians",
    "urad": "in µrad, not in radians",
    "arcmin": "in arc minutes, not in radians",
    "rad twice converted": "57.3 times too small: converted from degrees to radians twice",
    "rpm": "in rpm, not in rad/s",
    "Hz": "in turns a second, not in rad/s",
    "deg/s": "in degrees a second, not in rad/s",
    "mV": "in mV, not in V",
    "uV": "in µV, not in V",
    "kV": "1000 times too small, as mV read as µV or V as kV",
    "MV": "a million times too small",
    "mA": "in mA, not in A",
    "uA": "in µA, not in A",
    "kA": "1000 times too small, as A read as kA",
    "hPa": "in hPa, not in Pa",
    "kPa": "in kPa, not in Pa",
    "bar": "in bar, not in Pa",
    "mmHg": "in mmHg, not in Pa",
    "psi": "in psi, not in Pa",
    "deg C": "in °C, not in K",
}


def misstated_sentence(found: Misstated, model: str) -> str:
    """Return that a model file has another value of a bench parameter than the recordings show, and what to do."""
    own, there = quantity(found.value, found.unit), with_error(found.found, found.standard_error, found.unit)
    return (
        f"{found.name} is {own} in the model, {there} from the recordings: {found.far:.3g} standard errors; take "
        f"overrides.{found.name} out of {model}, or undo the change that set it"
    )


def problem(found: WrongSetup) -> str:
    """Return the problem in one sentence, with the physics that shows it."""
    return f"{_what(found)}: {_evidence(found)}."


def _what(found: WrongSetup) -> str:
    names, verb = listed(found.columns, "and"), "is" if len(found.columns) == 1 else "are"
    other = "".join(f", or {listed(columns, 'and')}" for columns in found.otherwise)
    if found.kind == "sign":
        signs = "sign" if len(found.columns) == 1 else "signs"
        turned = f"the {signs} of {names}{other} {verb} turned"
        mirrored = ", or the axes x and y of both are exchanged, or the wheel turns the other way"
        return turned + mirrored if _mirrored(found.columns) else turned
    if found.kind == "unit":
        units = [_UNITS.get(unit, f"in {unit}") for unit in found.unit.split(", ")]
        if len(units) > 1:
            return listed(
                [f"{name} is {unit}" for name, unit in zip(found.columns, units, strict=True)], "and"
            )
        return f"{names}{other} {verb} {units[0]}"
    if found.kind == "exchanged":
        if len(found.columns) > 2:
            return (
                "the axes x and y of tilts and coil voltages are exchanged, or the wheel turns the other way"
            )
        turned = ", and one of them has the other sign" if found.unit == "sign" else ""
        return f"{names} are exchanged{turned}"
    if found.kind == "same":
        return f"one signal stands in both {names}"
    if found.kind == "shifted":
        seconds = next(iter(found.cure.shift.values()))
        way = "late" if seconds < 0.0 else "early"
        shift = f"{abs(seconds):.2f} s {way} relative to the other readings"
        return f"{names}{other} {verb} {shift}, or of another recording"
    if found.kind == "stuck":
        from gyrowheel_recording.mapping.map_file import READINGS

        return f"{names} stays at {quantity(found.value, READINGS[found.columns[0]].unit)}"
    if found.kind == "held":
        return f"{names} {verb} new in {every(found.value)} sample only"
    if found.kind == "foreign" and len(found.columns) == 1:
        return f"{names}{other} {verb} another signal, as of another column or wire"
    if found.kind == "foreign":
        return "tilts and coil voltages do not belong together, as of two recordings or of other wires"
    if found.kind == "reversed":
        mirrored = "" if _reads_negative(found) else ", or the axes x and y of tilts and coils are mirrored"
        return f"the wheel turns the other way{mirrored}"
    if found.kind == "scale":
        factor = next(iter(found.cure.scale.values()))
        if found.columns == ("spin_angle",):
            turns = f"spin_angle counts {1.0 / abs(factor):g} turns a turn of the rotor"
            if factor < 0.0:
                return f"{turns} the other way"
            return f"{turns}, or the times of the samples are to be divided by {factor:g}"
        they = "it is" if len(found.columns) == 1 else "they are"
        return f"{names} {verb} read {'half' if factor > 1.0 else 'twice'} as large as {they}"
    if found.kind == "clock":
        angle, speed = found.columns
        return f"{angle} turns {1.0 / found.value:.4g} times as fast as {speed} shows"
    return f"is of another machine than {found.unit}"


def _evidence(found: WrongSetup) -> str:
    if found.kind == "unit" and not math.isnan(found.value):
        return f"{found.value:.5g} cannot be meant"
    if found.kind == "stuck":
        return "what it must follow moves"
    if found.kind == "held":
        instead = (
            f"; where the motor matters more than the tilt, leave out {listed(found.columns, 'and')} instead, "
            "which keeps every sample of the others"
            if found.cure.every > 1 and set(found.columns) <= _COILS
            else ""
        )
        return f"the readings of a slower instrument are repeated, as noise never repeats to the last digit{instead}"
    if found.kind == "clock":
        return (
            f"all readings of the spin agree where the times of the samples are divided by {found.value:.4g}"
        )
    if found.kind == "same":
        return (
            "the coils of two axes never take the same voltage"
            if "coil" in found.columns[0]
            else "to the last digit"
        )
    if found.kind == "another_machine" and math.isnan(found.value):
        return "the recordings say so"
    if found.kind == "another_machine":
        return f"the inertia that precession and ramps of the speed show is {found.value:.2f} times the one there"
    if set(found.columns) <= set(_SPIN) and found.kind != "reversed":
        return "angle, speed, motor voltage and current contradict each other, and agree with the cure"
    if found.kind == "foreign" and not found.cure:
        return f"precession leaves {100.0 * found.before:.0f} % of the coil torque unexplained"
    if not math.isnan(found.after):
        return (
            f"as recorded, precession leaves {100.0 * min(found.before, 9.99):.0f} % of the coil torque unexplained, "
            f"with the cure {100.0 * found.after:.0f} %"
        )
    return "the torque of precession and what was asked for say so"


def cure(found: Sequence[WrongSetup]) -> str:
    """Return the cure of all problems of one recording: a command, or advice where no command helps."""
    hopeless = [item for item in found if not item.cure]
    if hopeless:
        return "; ".join(dict.fromkeys(_hopeless(item) for item in hopeless))
    whole = found[0].cure
    for item in found[1:]:
        whole = whole.and_then(item.cure)
    place = found[0].recording.rstrip("/")
    return " ".join(
        ["gyrowheel correct", shlex.quote(place), "-o", shlex.quote(f"{place}-corrected"), *_options(whole)]
    )


def _options(whole: Fix) -> list[str]:
    """Return the options of ``gyrowheel correct``."""
    words = [f"--exchange {one}:{other}" for one, other in whole.exchange]
    for option, values in (("scale", whole.scale), ("offset", whole.offset), ("shift", whole.shift)):
        words += [f"--{option} {name}={value:.10g}" for name, value in values.items()]
    words += [f"--without {name}" for name in whole.without]
    return [*words, f"--every {whole.every:g}"] if whole.every > 1 else words


def _hopeless(found: WrongSetup) -> str:
    if found.kind == "same":
        return f"give {listed(found.columns, 'and')} a column (or a wire) each, and import or record again"
    if found.kind == "foreign" and len(found.columns) == 1:
        return f"give {found.columns[0]} its own column (or wire), and import or record again"
    if found.kind == "stuck":
        return f"check sensor, wire and imported column of {listed(found.columns, 'and')}, and record again"
    if found.kind == "held":
        return (
            f"record {listed(found.columns, 'and')} with a new reading in every sample, or import each instrument at "
            "its rate, with the times of these readings (`clock:` in the map)"
        )
    if found.kind == "clock":
        return "check at which rate the samples were taken, and the scales of both columns, and import or record again"
    if found.kind == "another_machine":
        return "diagnose the recordings of one machine at a time, unless they are mixed on purpose"
    return "take all readings from one recording, and import or record again"


def problem_and_map(found: WrongSetup) -> str:
    """Return the problem of an imported table, and the change of its map."""
    lines = "; ".join(map_lines(found))
    if not lines and found.kind in ("held", "clock"):
        return f"{problem(found)} To do: {_hopeless(found)}."
    return f"{problem(found)} In the map: {lines}." if lines else problem(found)


def map_lines(found: WrongSetup) -> list[str]:
    """Return the changes of the map of an imported table; none where a map cannot express them."""
    own = found.cure
    if own.shift or (found.kind == "scale" and "spin_angle" in own.scale):
        return []  # neither times nor the turns of another gear
    lines = [f"exchange the columns of columns.{one} and columns.{other}" for one, other in own.exchange]
    lines += [f"columns.{name}.scale: {value:.10g}" for name, value in own.scale.items()]
    # an offset of a map is in the unit of the table
    lines += [f"columns.{name}.unit: degC" for name in own.offset]
    lines += [f"leave out columns.{name}" for name in own.without]
    return [*lines, f"every: {own.every:g}"] if own.every > 1 else lines


def setup_line(found: Sequence[WrongSetup]) -> str:
    """Return problems and cures of recordings in one line, as for an error or a warning."""
    said = []
    for place in dict.fromkeys(item.recording for item in found):
        own = [item for item in found if item.recording == place]
        said.append(f"{place}: {'; '.join(_what(item) for item in own)}; cure: {cure(own)}")
    return "; ".join(said)


def cure_of(item: WrongSetup, found: Sequence[WrongSetup]) -> str:
    """Return the cure of the recording that a problem is of, all its other problems included."""
    return cure([other for other in found if other.recording == item.recording])


def _mirrored(columns: tuple[str, ...]) -> bool:
    return columns in (("tilt_x", "coil_voltage_x"), ("tilt_y", "coil_voltage_y"))


def _reads_negative(found: WrongSetup) -> bool:
    return "spin_rate" in found.cure.scale
