"""Generated reference pages: verbs and options, public names, messages."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import typer

import gyrowheel
from gyrowheel.cli.app import app
from gyrowheel_core.errors import InputError

ROOT: Final = Path(__file__).resolve().parent.parent
MESSAGES: Final = ROOT / "src" / "gyrowheel_msgs"
_MADE: Final = "<!-- Made by `make docs` from the code; edit that. -->"
#: Groups of the public names of `gyrowheel`; names without a group are last on the page.
_GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "Recordings": (
        "Recording",
        "simulate",
        "read_table",
        "read_bag",
        "suggest_map",
        "write_table",
        "salvage",
        "correct",
    ),
    "The loop": ("Model", "compare", "diagnose", "investigate", "own_effect"),
    "Measuring": ("calibrate", "rate", "drag", "torques", "momentum"),
    "Judging": ("campaign", "open_key", "paper", "Report"),
    "Catalogues": ("effects", "plans", "check_plan", "benches"),
    "Results": (
        "Comparison",
        "Diagnosis",
        "Addition",
        "Investigation",
        "Calibration",
        "Rates",
        "Drag",
        "Torques",
        "Momentum",
        "CampaignResult",
        "Key",
        "Paper",
        "PlanCheck",
        "TableMap",
    ),
    "Errors": ("InputError",),
}
#: Descriptions of names that are neither functions nor classes.
_NAMED: Final = {
    "effects": "Known physical effects by name: title, law, coefficients with units, usual sizes and sources.",
    "plans": "Test plans by name.",
    "benches": "Benches by name.",
}
_PARTS: Final = {"action": ("Goal", "Result", "Feedback"), "srv": ("Request", "Response"), "msg": ("",)}
_FIELD: Final = re.compile(r"^([\w/]+(?:\[\d*\])?)\s+(\w+)(=\S+)?\s*(?:#\s*(.*))?$")


def pages() -> dict[str, str]:
    """Return the reference pages by their names."""
    return {"cli.md": cli_page(), "api.md": api_page(), "messages.md": messages_page()}


# --- command line ---


def cli_page() -> str:
    """Return the page of the command line: every verb with its arguments and options."""
    root = typer.main.get_command(app)
    verbs = list(_verbs(root, "gyrowheel"))
    lines = [
        "# Command line",
        f"\n{_MADE}\n",
        f"{root.help}\n",
        f"{root.epilog}\n",
        "| verb | description |",
        "|---|---|",
        *(
            f"| [{name.removeprefix('gyrowheel ')}](#{_slug(name)}) | {_cell(_first(v))} |"
            for name, v in verbs
        ),
    ]
    for name, verb in verbs:
        lines += ["", *_verb(name, verb)]
    return "\n".join(lines) + "\n"


def _verbs(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    members = getattr(command, "commands", None)
    if members is None:
        yield name, command
        return
    for own, member in members.items():
        if not member.hidden:
            yield from _verbs(member, f"{name} {own}")


def _verb(name: str, verb: Any) -> Iterator[str]:
    arguments = [p for p in verb.params if p.param_type_name == "argument"]
    options = [p for p in verb.params if p.param_type_name == "option" and not p.hidden]
    words = [
        *(_metavar(p) if p.required else f"[{_metavar(p)}]" for p in arguments),
        *(f"{_long(p)} {_metavar(p)}".strip() for p in options if p.required),
        *(["[OPTIONS]"] if any(not p.required for p in options) else []),
    ]
    yield f"## {name}\n"
    yield "```"
    yield " ".join([name, *words])
    yield "```\n"
    yield _markup(inspect.cleandoc(verb.help or ""))
    rows = [*arguments, *options]
    if rows:
        yield "\n| | |"
        yield "|---|---|"
    for p in rows:
        shown = _metavar(p) if p.param_type_name == "argument" else _spelled(p)
        yield f"| `{_cell(shown)}` | {_cell(_markup(p.help or ''))}{_default(p)} |"
    if verb.epilog:
        yield f"\n{_markup(verb.epilog)}"


def _first(verb: Any) -> str:
    return _markup(inspect.cleandoc(verb.help or "").split("\n\n")[0].replace("\n", " "))


def _metavar(parameter: Any) -> str:
    if getattr(parameter, "is_flag", False):
        return ""
    return str(parameter.metavar or parameter.name.upper())


def _long(parameter: Any) -> str:
    return str(max(parameter.opts, key=len))


def _spelled(parameter: Any) -> str:
    names = ", ".join([*parameter.opts, *parameter.secondary_opts])
    return f"{names} {_metavar(parameter)}".strip()


def _default(parameter: Any) -> str:
    """Return the default of an option, if it is stated or evident."""
    shown, value = getattr(parameter, "show_default", False), parameter.default
    if isinstance(shown, str):
        return f" Default: {_cell(shown)}."
    if parameter.required:
        return " Required."
    if not shown or value is None or callable(value) or isinstance(value, bool) or value in ("", [], ()):
        return ""
    return f" Default: {_cell(str(value))}."


def _markup(text: str) -> str:
    """Return a help text in Markdown; coloured words become code."""
    return re.sub(r"\[(cyan|bold)\](.*?)\[/\1\]", r"`\2`", text)


def _slug(heading: str) -> str:
    return heading.replace(" ", "-")


def _cell(text: str) -> str:
    """Return a text for a table cell: one line, with code as its only markup."""
    parts = " ".join(text.split()).replace("|", "\\|").split("`")
    parts[::2] = [re.sub(r"([*<])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


# --- public names ---


def api_page() -> str:
    """Return the page of the public names; its comments tell the site which ones to describe in full.

    Raises
    ------
    InputError
        If a group has a name that is not public.
    """
    public = {name for name in gyrowheel.__all__ if not name.startswith("_")}
    grouped = [name for names in _GROUPS.values() for name in names]
    if gone := set(grouped) - public:
        raise InputError(
            f"tools/reference.py: _GROUPS: {', '.join(sorted(gone))}: no public names of gyrowheel"
        )
    groups = {**_GROUPS, "Further": tuple(sorted(public.difference(grouped)))}
    lines = [
        "# Python API",
        f"\n{_MADE}\n",
        "`import gyrowheel as gw`; an introduction: [from Python](../python.md). Here every public name has a line.",
        "The site (`make site`) and `help(gw.diagnose)` have the full descriptions, with parameters, units and errors.",
    ]
    for group, names in groups.items():
        if not names:
            continue
        lines += [f"\n## {group}\n", "| name | description |", "|---|---|"]
        lines += [f"| `{name}` | {_cell(_summary(name))} |" for name in names]
        lines += [f"\n<!-- api: {' '.join(names)} -->"]
    return "\n".join(lines) + "\n"


def _summary(name: str) -> str:
    text = _NAMED.get(name) or inspect.getdoc(getattr(gyrowheel, name)) or ""
    return text.split("\n\n")[0]


# --- messages ---


def messages_page() -> str:
    """Return the page of messages, services and the action, with the fields of each.

    Raises
    ------
    InputError
        If a line of a definition is neither a field nor a comment.
    """
    lines = [
        "# Messages",
        f"\n{_MADE}\n",
        "Interfaces of the package `gyrowheel_msgs`. Their topics and publishers:",
        "[the graph](../graph.md#topics).",
    ]
    for kind, parts in _PARTS.items():
        for path in sorted((MESSAGES / kind).glob(f"*.{kind}")):
            lines += [f"\n## gyrowheel_msgs/{kind}/{path.stem}", *_definition(path, parts)]
    return "\n".join(lines) + "\n"


def _definition(path: Path, parts: tuple[str, ...]) -> Iterator[str]:
    sections = path.read_text(encoding="utf-8").split("---\n")
    for title, text in zip(parts, sections, strict=True):
        comments, rows = [], []
        for line in text.splitlines():
            if line.startswith("#"):
                comments.append(line.removeprefix("#").strip())
            elif line.strip():
                rows.append(_field(path, line))
        if comments:
            yield "\n" + "\n".join(comments).strip()
        if title:
            yield f"\n**{title}**" + ("" if rows else ": empty")
        if rows:
            yield "\n| field | type | meaning |"
            yield "|---|---|---|"
            yield from rows


def _field(path: Path, line: str) -> str:
    found = _FIELD.match(line.strip())
    if found is None:
        raise InputError(f"{path.name}: {line!r} is no field")
    kind, name, value, comment = found.groups()
    words = [text for text in (f"constant {value[1:]}" if value else "", comment or "") if text]
    return f"| `{name}` | `{kind}` | {_cell('; '.join(words))} |"
