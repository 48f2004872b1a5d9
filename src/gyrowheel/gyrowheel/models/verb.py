"""The verb `model`: everything that changes a model file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrowheel.cli.console import editing, out, put, put_content, put_text, working
from gyrowheel.cli.options import (
    BenchName,
    ErrorPicture,
    Json,
    Mixed,
    ModelFile,
    Validation,
    argument,
    example,
    option,
)
from gyrowheel.cli.outputs import PICTURE
from gyrowheel.show.files import require_writable
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel import Model
    from gyrowheel.catalogue.api import Effect

model_app = typer.Typer(
    help="Edit a model file: new, add, fit, remove, show, undo, diff, export.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@model_app.command(epilog=example("gyrowheel model new --model wheel.yaml"))
def new(model: ModelFile, bench: BenchName = "gyrowheel") -> None:
    """Make a model file: a bench without effects."""
    from gyrowheel import Model

    with editing(model):
        if model.exists():
            raise InputError(f"{model}: exists; name a new file")
        Model(bench).save(model)
    out().print(f"model: {model}", soft_wrap=True)


@model_app.command(epilog=example("gyrowheel model add windage --model wheel.yaml --fit runs/monday"))
def add(
    model: ModelFile,
    fit: Annotated[list[Path], option("--fit DIR", "Recording to fit. Repeatable.")],
    effects: Annotated[
        list[str] | None,
        argument(
            "EFFECT...",
            "Effects to add; aero:MODEL adds all effects of an air model, fitted within its uncertainties.",
        ),
    ] = None,
    formula: Annotated[
        list[str] | None,
        option(
            "--formula TEXT",
            "User-defined effect, such as '-k*r^2*z'; docs/formulas.md describes the grammar. Repeatable.",
        ),
    ] = None,
    name: Annotated[str | None, option("--name NAME", "Name of the formula's effect.", "own")] = None,
    target: Annotated[str | None, option("--target T", "What the formula acts on.", "rotor_torque")] = None,
    map_: Annotated[
        bool,
        option(
            "--map",
            "Add the missing torque as a smooth function of tilt, speed and temperature: no law needed.",
        ),
    ] = False,
    validate: Validation = None,
    mixed: Mixed = False,
    picture: ErrorPicture = None,
    json: Json = None,
) -> None:
    """Add effects or formulas: fit their coefficients, show the error before and after, save the model."""
    from gyrowheel import Model
    from gyrowheel.models.api import require_known
    from gyrowheel.recordings.inputs import opened_apart
    from gyrowheel.show.layout import Unbroken

    require_writable(model)
    with editing(model):
        loaded = Model.load(model)
        chosen: list[str | Effect] = [*(effects or ()), *_typed(formula or (), name, target, loaded)]
        if not chosen and not map_:
            raise InputError("nothing to add: name an effect, or give --formula or --map")
        if chosen and map_:
            raise InputError("--map: is fitted to all that is missing; add it alone")
        for effect in effects or ():
            require_known(effect)
        if map_:
            chosen = ["map"]
        recordings, unused = opened_apart(fit, validate or ())
        with working("fitting") as say:
            better = loaded.add(chosen, fit=recordings, validate=unused, mixed=mixed, progress=say)
            better.save(model)
    added = better.added
    assert added is not None  # made by add
    put(added, json, picture, after=[Unbroken(f"\nmodel: {model}")])


@model_app.command(
    name="fit", epilog=example("gyrowheel model fit --free windage --model wheel.yaml --fit runs/monday")
)
def fit_parameters(
    model: ModelFile,
    fit: Annotated[list[Path], option("--fit DIR", "Recording to fit. Repeatable.")],
    free: Annotated[
        list[str] | None,
        option(
            "--free NAME",
            "Parameter to estimate: windage.w, windage (its coefficients), bench (its uncertain parameters), or a "
            "pattern with *. Repeatable.",
            "all",
        ),
    ] = None,
    fixed: Annotated[
        list[str] | None, option("--fixed NAME", "Parameter to hold at the model's value. Repeatable.")
    ] = None,
    prior: Annotated[
        list[str] | None,
        option("--prior NAME=MEAN,SD", "Prior in SI units; NAME=none for no prior. Repeatable.", "as stated"),
    ] = None,
    bounds: Annotated[
        list[str] | None, option("--bounds NAME=LOW,HIGH", "Range in SI units. Repeatable.")
    ] = None,
    loss: Annotated[
        str,
        option("--loss L", "linear (least squares), or soft_l1, huber, cauchy for noise with heavy tails."),
    ] = "linear",
    write: Annotated[bool, option("--write", "Write the estimates into the model file.")] = False,
    mixed: Mixed = False,
    picture: Annotated[
        Path | None, option("--picture F.png|svg|pdf", "Draw the correlation of the estimates."), PICTURE
    ] = None,
    json: Json = None,
) -> None:
    """Estimate chosen parameters: priors, bounds, covariance, information criteria. Written only with --write."""
    from gyrowheel import Model
    from gyrowheel.show.layout import Unbroken

    priors = dict(map(_pair_of("--prior", none=True), prior or ()))
    ranges = {name: ends for name, ends in map(_pair_of("--bounds"), bounds or ()) if ends is not None}
    if write:
        require_writable(model)
    with editing(model) if write else contextlib.nullcontext():
        loaded = Model.load(model)
        with working("fitting") as say:
            result = loaded.fit(
                fit,
                free=free,
                fixed=fixed or (),
                priors=priors,
                bounds=ranges,
                loss=loss,
                mixed=mixed,
                progress=say,
            )
        if write:
            result.model.save(model)
    text = (
        f"\nmodel: {model}"
        if write
        else "\nThe model file is unchanged; --write writes the estimates into it."
    )
    put(result, json, picture, after=[Unbroken(text)])


def _pair_of(field: str, *, none: bool = False) -> Callable[[str], tuple[str, tuple[float, float] | None]]:
    """Return the reader of an option ``NAME=A,B``, or ``NAME=none`` where that is allowed."""

    def read(text: str) -> tuple[str, tuple[float, float] | None]:
        name, _, ends = text.partition("=")
        if none and ends.strip() == "none":
            return name.strip(), None
        try:
            first, second = (float(part) for part in ends.split(","))
        except ValueError:
            also = ", or NAME=none" if none else ""
            raise InputError(f"{field}: {text!r} is not allowed; allowed: NAME=A,B{also}") from None
        return name.strip(), (first, second)

    return read


@model_app.command(epilog=example("gyrowheel model remove windage --model wheel.yaml"))
def remove(
    effects: Annotated[list[str], argument("EFFECT...", "Effects to remove.")], model: ModelFile
) -> None:
    """Remove effects; the other coefficients keep their values."""
    from gyrowheel import Model
    from gyrowheel.models.page import difference

    with editing(model):
        before = Model.load(model)
        after = before.remove(*effects)
        after.save(model)
    put_text(difference(before.details, after.details))


@model_app.command(epilog=example("gyrowheel model show --model wheel.yaml"))
def show(model: ModelFile, json: Json = None) -> None:
    """Show effects, estimated parameters and history of a model."""
    from gyrowheel import Model

    put(Model.load(model), json)


@model_app.command(epilog=example("gyrowheel model export --model wheel.yaml -o wheel.fmu"))
def export(
    model: ModelFile,
    output: Annotated[Path, option("-o --output FILE", "File to write: .fmu or .py.")],
    format_: Annotated[
        str | None, option("--format F", "fmu (FMI 2.0, co-simulation) or python.", "by the file's ending")
    ] = None,
) -> None:
    """Write the plant of a model for other programs: an FMU for Simulink or Modelica, or a Python module."""
    from gyrowheel import Model

    require_writable(output)
    with working("exporting"):
        Model.load(model).export(output, format_)
    out().print(f"plant: {output}", soft_wrap=True)


@model_app.command(epilog=example("gyrowheel model undo --model wheel.yaml"))
def undo(model: ModelFile) -> None:
    """Undo the last change of a model."""
    from gyrowheel import Model
    from gyrowheel.models.page import difference

    with editing(model):
        before = Model.load(model)
        after = before.undo()
        after.save(model)
    last = before.history[-1]
    out().print(f"undone: {last.get('what', 'the last change')} ({last.get('time', 'no time')})")
    put_text(difference(before.details, after.details))


@model_app.command(epilog=example("gyrowheel model diff old.yaml new.yaml"))
def diff(
    old: Annotated[Path, argument(None, "Model file.")],
    new: Annotated[Path, argument(None, "Model file to compare with it.")],
    json: Json = None,
) -> None:
    """Show the differences between two models."""
    from gyrowheel import Model
    from gyrowheel.models.page import difference

    before, after = Model.load(old), Model.load(new)
    put_content(
        json, {"schema": 1, "differences": before.diff(after)}, difference(before.details, after.details)
    )


def _typed(formulas: Sequence[str], name: str | None, target: str | None, model: Model) -> list[Effect]:
    """Return the effects that were typed as formulas, under names that nothing has yet."""
    if len(formulas) != 1 and (name or target):
        raise InputError(f"--{'name' if name else 'target'}: is for one --formula; {len(formulas)} are given")
    if not formulas:
        return []
    from gyrowheel import own_effect

    typed: list[Effect] = []
    for text in formulas:
        taken = {*model.effects, *(effect.name for effect in typed)}
        typed.append(own_effect(text, name=name, target=target, taken=taken, where="--formula"))
    return typed
