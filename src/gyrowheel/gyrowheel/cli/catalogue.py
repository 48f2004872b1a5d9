"""Verbs that show what there is: effects, plans, bench."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrowheel.cli.options import BenchName, Json, example
from gyrowheel.cli.shell import put_json, put_text


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
    from gyrowheel.catalogue import effect_on, load_bench
    from gyrowheel.catalogue import effects as known
    from gyrowheel.text import effects as render

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
    json: Json = None,
) -> None:
    """List the shipped test plans, or show one segment by segment."""
    from gyrowheel.catalogue import load_plan
    from gyrowheel.catalogue import plans as shipped
    from gyrowheel.text import plans as render

    chosen = [load_plan(item) for item in (shipped if name is None else [name])]
    if json is not None:
        pages = [render.plan_json(plan) for plan in chosen]
        put_json(json, {"schema": 1, "plans": pages} if name is None else {"schema": 1, **pages[0]})
    if json != "-":
        put_text(render.plan_list(chosen) if name is None else render.plan_page(chosen[0]))


def bench(bench: BenchName = "gyrowheel", json: Json = None) -> None:
    """Show every parameter of the bench with its uncertainty and source."""
    import json as text

    from gyrowheel.catalogue import load_bench
    from gyrowheel.text.bench import bench_page

    loaded = load_bench(bench)
    if json is not None:
        put_json(json, text.loads(loaded.describe()) | {"references": dict(loaded.references)})
    if json != "-":
        put_text(bench_page(loaded))
