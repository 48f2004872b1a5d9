"""The messages as their files say: what is installed was built from these files, and every number names its unit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "gyrowheel_msgs"
FILES = sorted(path for kind in ("msg", "srv", "action") for path in PACKAGE.glob(f"{kind}/*.{kind}"))
#: Parts of a service and of an action, as rosidl names their classes.
PARTS = {"msg": ("",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
LINE = re.compile(r"^(?P<type>[\w/\[\]]+) +(?P<name>[a-z]\w*)\s*(?:#(?P<comment>.*))?$")


def definitions() -> Iterator[tuple[str, str, list[re.Match[str]]]]:
    """Yield folder, class and lines of fields of every definition."""
    for path in FILES:
        kind = path.suffix[1:]
        for part, text in zip(PARTS[kind], path.read_text().split("\n---\n"), strict=True):
            lines = (LINE.match(line) for line in text.splitlines())
            name = f"{path.stem}_{part}" if part else path.stem
            yield kind, name, [line for line in lines if line is not None]


@pytest.mark.parametrize(
    ("kind", "name", "lines"),
    [*definitions()],
    ids=lambda value: str(value) if isinstance(value, str) else "",
)
def test_what_is_installed_has_the_fields_of_its_file(
    kind: str, name: str, lines: list[re.Match[str]]
) -> None:
    module = import_module(f"gyrowheel_msgs.{kind}")
    class_ = getattr(module, name.partition("_")[0])
    for part in name.split("_")[1:]:
        class_ = getattr(class_, part)
    rosidl = {"float64": "double", "bool": "boolean"}

    def plain(kind: str) -> str:
        base, _, count = kind.partition("[")
        return rosidl.get(base, base) + (f"[{count}" if count else "")

    wanted = {line["name"]: plain(line["type"]) for line in lines}
    assert dict(class_.get_fields_and_field_types()) == wanted


def test_every_number_of_a_message_names_its_unit() -> None:
    fields = [line for kind, _, lines in definitions() if kind == "msg" for line in lines]
    numbers = [line for line in fields if line["type"].startswith("float64")]
    assert len(numbers) > 20
    assert [line["name"] for line in numbers if not re.search(r"\[.+\]", line["comment"] or "")] == []


def test_every_file_is_built() -> None:
    built = set(re.findall(r'"(\w+/\w+\.\w+)"', (PACKAGE / "CMakeLists.txt").read_text()))
    assert {f"{path.parent.name}/{path.name}" for path in FILES} <= built
