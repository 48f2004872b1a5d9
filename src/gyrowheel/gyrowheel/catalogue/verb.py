"""Verbs that show effects, plans and benches, and begin files of them."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from gyrowheel.cli.console import BAD_INPUT, put, put_content, put_json
from gyrowheel.cli.options import BenchName, Json, argument, option
from gyrowheel_core.errors import InputError


def effects(
    name: Annotated[str | None, argument(None, "Effect to show in full.")] = None,
    bench: BenchName = "gyrowheel",
    json: Json = None,
) -> None:
    """List the known effects, or show one in full, with its usual sizes on a bench.

    Errors of bench parameters that a diagnosis can report are shown by their names, such as coil_gain_error.
    """
    from gyrowheel.catalogue import page as render
    from gyrowheel.catalogue.api import effect_on, load_bench
    from gyrowheel.catalogue.api import effects as known
    from gyrowheel.show.sentences.diagnosis import ERROR_TITLES

    loaded = load_bench(bench)
    if name in ERROR_TITLES:
        from gyrowheel.catalogue.parameter_error import parameter_error

        error = parameter_error(name, loaded)
        shown = {"schema": 1, **render.parameter_error_json(error)}
        put_content(json, shown, render.parameter_error_page(error))
        return
    chosen = [effect_on(effect, loaded) for effect in (known if name is None else [name])]
    if name is None:
        content: dict[str, Any] = {"effects": [render.effect_json(effect) for effect in chosen]}
        put_content(json, {"schema": 1, **content}, render.effect_list(chosen))
    else:
        put_content(json, {"schema": 1, **render.effect_json(chosen[0])}, render.effect_page(chosen[0]))


def plans(
    name: Annotated[
        str | None,
        argument(
            None, "Plan to show in full: shipped name, or a plan file; also varied, as quick@rig=inverted."
        ),
    ] = None,
    new: Annotated[Path | None, option("--new FILE", "Write a plan file to begin with.")] = None,
    check: Annotated[
        Path | None, option("--check FILE", "Show all errors of a plan file, or its content and demands.")
    ] = None,
    schema: Annotated[
        bool, option("--schema", "Write the JSON schema of plan files, for editors, to stdout.")
    ] = False,
    bench: Annotated[
        str | None,
        option(
            "--bench B",
            "Bench that shall run it: shipped name (gyrowheel, dtg), or a bench file.",
            "gyrowheel; plans are shown as they are written",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """List the shipped test plans, or show one segment by segment; with a bench, adapted to it.

    --new, --check and --schema help to write a new plan; docs/plans.md has every key.
    """
    asked = [option for option, given in (("--new", new), ("--check", check), ("--schema", schema)) if given]
    if asked and (name is not None or len(asked) > 1):
        others = [*asked[1:], *([] if name is None else [f"'{name}'"])]
        raise InputError(f"{asked[0]}: cannot be combined with {others[0]}")
    if schema:
        from gyrowheel.catalogue.api import plan_schema

        put_json("-", plan_schema())
    elif new is not None:
        _new_plan(new, bench, json)
    elif check is not None:
        _check_plan(check, bench, json)
    else:
        _show_plans(name, bench, json)


def _new_plan(file: Path, bench: str | None, json: str | None) -> None:
    from gyrowheel.catalogue.api import new_plan
    from gyrowheel.show.layout import Unbroken, command

    new_plan(file, bench or "gyrowheel")
    other = "" if bench is None else f" --bench {shlex.quote(bench)}"
    put_content(
        json,
        {"schema": 1, "file": str(file), "bench": bench or "gyrowheel"},
        [Unbroken(f"plan: {file}"), command(f"gyrowheel plans --check {shlex.quote(str(file))}{other}")],
    )


def _check_plan(file: Path, bench: str | None, json: str | None) -> None:
    from gyrowheel.catalogue.api import check_plan

    found = check_plan(file, bench or "gyrowheel")
    put(found, json)
    if not found.good:
        raise typer.Exit(BAD_INPUT)


def _show_plans(name: str | None, bench: str | None, json: str | None) -> None:
    from gyrowheel.catalogue import page as render
    from gyrowheel.catalogue.api import load_bench, load_plan, plan_on, plans_on
    from gyrowheel.catalogue.api import plans as shipped

    if bench is None:
        chosen = [load_plan(item) for item in (shipped if name is None else [name])]
    else:
        loaded = load_bench(bench)
        chosen = plans_on(loaded) if name is None else [plan_on(loaded, name)]
    if name is None:
        content: dict[str, Any] = {"plans": [render.plan_json(plan) for plan in chosen]}
        put_content(json, {"schema": 1, **content}, render.plan_list(chosen))
    else:
        put_content(json, {"schema": 1, **render.plan_json(chosen[0])}, render.plan_page(chosen[0]))


def bench(
    bench: BenchName = "gyrowheel",
    new: Annotated[Path | None, option("--new FILE", "Write a bench file to begin with.")] = None,
    like: Annotated[
        str | None,
        option(
            "--like B",
            "With --new: the bench whose values it has, a shipped name or a bench file.",
            "gyrowheel",
        ),
    ] = None,
    reach: Annotated[bool, option("--reach", "Show what coils and motor can reach, and the limits.")] = False,
    json: Json = None,
) -> None:
    """Show every parameter of the bench with its uncertainty and source, or begin a new bench file.

    docs/your_bench.md goes the whole way from a new bench to a diagnosis.
    """
    if new is not None:
        _new_bench(new, like or "gyrowheel", json)
        return
    if like is not None:
        raise InputError("--like: is only of use with --new")
    import json as text

    from gyrowheel.catalogue import api
    from gyrowheel.catalogue.page import bench_page, reach_page

    loaded = api.load_bench(bench)
    found = api.reach(loaded) if reach else None
    content = text.loads(loaded.describe()) | {"references": dict(loaded.references)}
    if found is not None:
        content["reach"] = api.reach_json(found)
    put_content(json, content, bench_page(loaded) if found is None else reach_page(found))


def _new_bench(file: Path, like: str, json: str | None) -> None:
    from gyrowheel.catalogue.api import new_bench
    from gyrowheel.show.layout import Unbroken, command

    new_bench(file, like)
    shown = command(f"gyrowheel bench --bench {shlex.quote(str(file))} --reach")
    put_content(json, {"schema": 1, "file": str(file), "like": like}, [Unbroken(f"bench: {file}"), shown])
