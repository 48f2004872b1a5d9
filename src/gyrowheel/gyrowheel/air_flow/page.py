"""The air: torques by model, computed cases, torque tables and their check lists."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import Unbroken, command, figures_table, heading, sentences, words_table
from gyrowheel_core.quantities import decimal, fixed, minus, pair, short, with_error
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_air.cfd.case import Case, Result
    from gyrowheel_air.cfd.sweep import Outcome
    from gyrowheel_air.check import Check
    from gyrowheel_air.compare import Comparison
    from gyrowheel_air.table import TorqueTable

_AXES = (
    "T1 about the axis of the tilt (minus: back towards the case axis), T2 a quarter turn ahead of it, "
    "T3 about the rotor's axis (minus: brakes)"
)
_UNITS = {"k": "N*m/rad", "c": "N*m/rad", "w": "N*m", "n": "1"}


def comparison_page(found: Comparison) -> Iterator[RenderableType]:
    """Yield the torques of all models in one table, and the coefficients of the air effects."""
    tilt = math.hypot(*found.tilt) / DEG
    yield Text.assemble(
        ("air torque on the rotor", "bold cyan"),
        f"  tilt {tilt:.4g}°, {found.spin_rate / RPM:.6g} rpm, {found.air.density:.4g} kg/m³\n"
        f"Re {found.reynolds:.3g}, density changes by {100 * found.density_change:.2g} %\n",
    )
    table = figures_table("model", "T1", "T2", "T3")
    table.add_row("", *[Text("mN·m", style="dim")] * 3)
    for name, torque in found.torques.items():
        table.add_row(
            Text(name, style="cyan"),
            *(_pair(v, e) for v, e in zip(torque.components, torque.uncertainty, strict=True)),
        )
    yield table
    yield Text(f"\n{_AXES}; –: not given by the model", style="dim")
    yield heading("As coefficients of the air effects")
    laws = words_table("model", "effect", "size", "exponent n", whole=(0, 1, 2, 3))
    for model, effects in found.coefficients.items():
        shown: str | Text = Text(model, style="cyan")
        for effect, members in effects.items():
            name, size = next(item for item in members.items() if item[0] != "n")
            laws.add_row(shown, effect, f"{name} = {with_error(*size, _UNITS[name])}", _pure(*members["n"]))
            shown = ""
    yield laws
    if found.options:
        yield heading("As options of simulate and up, from the torque table")
        for option in found.options:
            yield command(f"--effect {option}")
    if found.refused:
        yield heading("Not shown")
        yield from sentences(f"{name}: {why}" for name, why in found.refused.items())


def mesh_page(case: Case, quality: dict[str, Any], folder: str) -> Iterator[RenderableType]:
    """Yield the report of checkMesh."""
    table = words_table("", "")
    for name, value in (
        ("cells", f"{quality['cells']}"),
        ("largest non-orthogonality", f"{quality['non_orthogonality']:.1f}°"),
        ("largest skewness", f"{quality['skewness']:.2f}"),
        ("largest aspect ratio", f"{quality['aspect_ratio']:.0f}"),
        ("checkMesh", "mesh OK" if quality["ok"] else "bad"),
    ):
        table.add_row(name, value)
    yield Text.assemble((case.mesh, "bold cyan"), f"  tilt {short(case.tilt / DEG, 4)}°\n")
    yield table
    yield Unbroken(f"mesh: {folder}")


def result_page(result: Result, folder: str) -> Iterator[RenderableType]:
    """Yield the torques of one case."""
    case, torque, origin = result.case, result.torque, result.provenance
    yield Text.assemble(
        (f"{case.mesh} {origin['model']}", "bold cyan"),
        f"  tilt {short(case.tilt / DEG, 4)}°, {case.spin_rate / RPM:.6g} rpm, {origin['cells']} cells\n",
    )
    table = figures_table(
        f"mean of {torque.window} iterations", "torque", "scatter", "drift", "pressure part"
    )
    table.add_row("", *[Text("mN·m", style="dim")] * 3, Text("%", style="dim"))
    for i, name in enumerate(("T1 back (−)", "T2 across", "T3 along the rotor")):
        # the part of the pressure in a torque that symmetry makes zero means nothing
        whole = abs(torque.mean[i]) > 2.0 * torque.scatter[i]
        table.add_row(
            name,
            fixed(1e3 * torque.mean[i], 4),
            fixed(1e3 * torque.scatter[i], 2),
            fixed(1e3 * torque.drift[i], 2),
            decimal(100.0 * torque.pressure[i] / torque.mean[i], 0) if whole else "–",
        )
    yield table
    wall = result.y_plus["rotor"]
    yield Text("")
    yield from sentences(
        [
            _state(result),
            f"y+ on the rotor {wall[0]:.2f} on average, {wall[1]:.2f} at most; "
            + ("wall functions" if origin["wall_functions"] else "wall layer resolved"),
            f"{origin['iterations']} iterations from: {origin['first_guess']}",
            f"OpenFOAM {origin['version']}, {origin['cpu_seconds']:.0f} s of one core",
        ]
    )
    yield Unbroken(f"case: {folder}")


def sweep_line(case: Case, result: Result | str, done: int, total: int) -> str:
    """Return one line about a case of a sweep."""
    what = f"{done}/{total}  {case.tilt / DEG:+.4g}° {case.spin_rate / RPM:.6g} rpm  {case.mesh} {case.model}"
    if case.direction:
        what += f" axis {case.direction / DEG:.4g}°"
    what = minus(what)
    if isinstance(result, str):
        return f"{what}: failed: {result}"
    torques = "  ".join(fixed(1e3 * value) for value in result.torque.mean)
    return f"{what}: {torques} mN·m{_marks(result)}"


def sweep_page(outcome: Outcome, folder: str) -> Iterator[RenderableType]:
    """Yield the result of a sweep."""
    count = len(outcome.results)
    yield Text(f"{count} cases finished, {outcome.reused} of them earlier; {len(outcome.failed)} failed")
    yield from sentences(f"{name}: {why}" for name, why in outcome.failed.items())
    yield heading("Next")
    yield Unbroken(f"  gyrowheel cfd table {folder} --check", style="cyan")


def table_page(table: TorqueTable) -> Iterator[RenderableType]:
    """Yield a torque table."""
    first = table.grid[0]
    mesh, _ = table.method
    yield Text.assemble(
        (table.origin, "bold cyan"),
        f"  {len(table.grid)} cases over {len(table.tilts)} tilts and {len(table.speeds)} speeds, "
        f"{len(table.rows) - len(table.grid)} others\nmesh {mesh} ({first.provenance['cells']} cells), "
        f"{first.provenance['model']}, OpenFOAM {first.provenance['version']}, air {table.air.density:.4g} kg/m³\n",
    )
    for i, name in enumerate(("T1 about the axis of the tilt", "T2 across", "T3 along the rotor's axis")):
        yield Text(f"{name}, mN·m", style="bold")
        part = figures_table("tilt", *(f"{speed / RPM:.0f} rpm" for speed in table.speeds))
        for tilt in table.tilts:
            cells = []
            for speed in table.speeds:
                row = table.at(tilt, speed)
                assert row is not None
                zero = i < 2 and tilt == 0.0
                cells.append("0" if zero else f"{_marks(row)} {fixed(1e3 * row.torque.mean[i])}".strip())
            part.add_row(f"{short(tilt / DEG, 4)}°", *cells)
        yield part
        yield Text("")
    others = [r for r in table.rows if r not in table.grid]
    if others:
        yield Text("Other meshes, models and axes", style="bold")
        part = figures_table("case", "cells", "y+", "T1", "T2", "T3")
        for row in others:
            c = row.case
            name = f"{c.tilt / DEG:+.4g}° {c.spin_rate / RPM:.6g} rpm {c.mesh} {c.model}"
            name += f" axis {c.direction / DEG:.4g}°" if c.direction else ""
            values = ["0" if i < 2 and c.tilt == 0.0 else fixed(1e3 * row.torque.mean[i]) for i in range(3)]
            values[0] = f"{_marks(row)} {values[0]}".strip()
            part.add_row(minus(name), str(row.provenance["cells"]), f"{row.y_plus['rotor'][0]:.1f}", *values)
        yield part
    yield Text("\nd: mean still drifting by more than 1 %; u: unsteady, scatter above 2 %", style="dim")


def check_page(table: TorqueTable, checks: Sequence[Check]) -> Iterator[RenderableType]:
    """Yield the check list of a table."""
    yield Text.assemble((table.origin, "bold cyan"), f"  {len(table.rows)} cases\n")
    part = words_table("", "")
    for item in checks:
        mark, style = {True: ("holds", "green"), False: ("MISSES", "red"), None: ("–", "dim")}[item.holds]
        notes = [("paper", item.paper), ("cause", item.cause), ("bar", item.bar)]
        lines = [item.found, *(f"{title}: {words}" for title, words in notes if words)]
        part.add_row(
            Text(mark, style=style),
            Text.assemble(minus(item.what), *((f"\n{minus(x)}", "dim") for x in lines)),
        )
    yield part
    held = sum(item.holds is True for item in checks)
    yield Text(f"\n{held} of {len(checks)} hold\n")
    yield from sentences(
        [
            "bar: origin of the limits: the values found, within their uncertainty for sizes, twice of it for other "
            "numbers, three times of it for numbers of every row.",
            "paper: Huo et al. 2016.",
        ]
    )


def table_json(table: TorqueTable, checks: Sequence[Check]) -> dict[str, Any]:
    """Return a table and its check list as plain values [SI]."""
    mesh, model = table.spread
    return {
        "schema": 1,
        "origin": table.origin,
        "mesh": table.method[0],
        "model": table.method[1],
        "tilts": table.tilts,
        "speeds": table.speeds,
        "spread_over_meshes": mesh,
        "spread_over_models": model,
        "rows": [row.to_json() for row in table.rows],
        "checks": [asdict(line) for line in checks],
    }


def _state(result: Result) -> str:
    torque = result.torque
    steady = "steady" if torque.steady else "unsteady: the torque scatters by more than 2 %"
    settled = "settled" if torque.settled else "not settled: the mean still drifts by more than 1 %"
    return f"{settled}; {steady}"


def _marks(result: Result) -> str:
    marks = ("" if result.torque.settled else "d") + ("" if result.torque.steady else "u")
    return f" {marks}" if marks else ""


def _pair(value: float, error: float) -> str:
    if not math.isfinite(value):
        return "–"
    return "0" if value == 0.0 else pair(1e3 * value, 1e3 * error)


def _pure(value: float, error: float) -> str:
    return pair(value, error) if error > 1e-9 else short(value)
