"""Verbs that show effects, plans and benches, and begin files of them."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import BAD_INPUT, out, put, put_json, put_text
from gyrowheel.cli.options import BenchName, Json, example
from gyrowheel_core.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command(epilog=example("gyrowheel effects windage"))(effects)
    app.command(epilog=example("gyrowheel plans quick"))(plans)
    app.command(epilog=example("gyrowheel bench"))(bench)


def effects(
    name: Annotated[str | None, typer.Argument(help="Effect to show in full.", show_default=False)] = None,
    bench: BenchName = "gyrowheel",
    json: Json = None,
) -> None:
    """List the known effects, or show one in full, with its usual sizes on a bench."""
    from gyrowheel.catalogue import page as render
    from gyrowheel.catalogue.api import effect_on, load_bench
    from gyrowheel.catalogue.api import effects as known

    loaded = load_bench(bench)
    chosen = [effect_on(loaded, effect) for effect in (known if name is None else [name])]
    if json is not None:
        pages = [render.effect_json(effect) for effect in chosen]
        put_json(json, {"schema": 1, "effects": pages} if name is None else {"schema": 1, **pages[0]})
    if json != "-":
        put_text(render.effect_list(chosen) if name is None else render.effect_page(chosen[0]))


def plans(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Plan to show in full: shipped name, or a plan file; also varied, as quick@rig=inverted.",
            show_default=False,
        ),
    ] = None,
    new: Annotated[
        Path | None,
        typer.Option("--new", metavar="FILE", help="Write a plan file to begin with.", show_default=False),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            "--check",
            metavar="FILE",
            help="Show all errors of a plan file, or what it will do.",
            show_default=False,
        ),
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Write the JSON schema of plan files, for editors, to stdout.")
    ] = False,
    bench: Annotated[
        str | None,
        typer.Option(
            "--bench",
            metavar="B",
            help="Bench that shall run it: shipped name (gyrowheel, dtg), or a bench file.",
            show_default="gyrowheel; plans are shown as they are written",
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
    from gyrowheel.show.layout import command

    new_plan(file, bench or "gyrowheel")
    other = "" if bench is None else f" --bench {shlex.quote(bench)}"
    if json is not None:
        put_json(json, {"schema": 1, "file": str(file), "bench": bench or "gyrowheel"})
    if json != "-":
        out().print(f"plan: {file}", soft_wrap=True)
        put_text([command(f"gyrowheel plans --check {shlex.quote(str(file))}{other}")])


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
    if json is not None:
        pages = [render.plan_json(plan) for plan in chosen]
        put_json(json, {"schema": 1, "plans": pages} if name is None else {"schema": 1, **pages[0]})
    if json != "-":
        put_text(render.plan_list(chosen) if name is None else render.plan_page(chosen[0]))


def bench(
    bench: BenchName = "gyrowheel",
    new: Annotated[
        Path | None,
        typer.Option("--new", metavar="FILE", help="Write a bench file to begin with.", show_default=False),
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            "--like",
            metavar="B",
            help="With --new: the bench whose values it has, a shipped name or a bench file.",
            show_default="gyrowheel",
        ),
    ] = None,
    reach: Annotated[
        bool, typer.Option("--reach", help="Show what coils and motor can reach, and the limits.")
    ] = False,
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
    if json is not None:
        content = text.loads(loaded.describe()) | {"references": dict(loaded.references)}
        if found is not None:
            content["reach"] = api.reach_json(found)
        put_json(json, content)
    if json != "-":
        put_text(bench_page(loaded) if found is None else reach_page(found))


def _new_bench(file: Path, like: str, json: str | None) -> None:
    from gyrowheel.catalogue.api import new_bench
    from gyrowheel.show.layout import command

    new_bench(file, like)
    if json is not None:
        put_json(json, {"schema": 1, "file": str(file), "like": like})
    if json != "-":
        out().print(f"bench: {file}", soft_wrap=True)
        put_text([command(f"gyrowheel bench --bench {shlex.quote(str(file))} --reach")])
