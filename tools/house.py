"""The house: packages and what is in them, lowest first. Its test holds the imports to it; ``make docs`` draws it."""

from __future__ import annotations

from typing import NamedTuple

from gyrowheel_core.errors import InputError


class Package(NamedTuple):
    """One package: what it is about, and its modules and folders in the order in which they may import each other.

    Each floor imports only those before it; what stands on one floor does not import each other. A module that stands
    on another floor than its folder is named with it (``campaigns.judge``).
    """

    name: str
    about: str
    floors: tuple[tuple[str, ...], ...]

    def floor_of(self, part: str) -> int:
        """Return the number of the floor of a module, by its name or that of its folder, the nearest that is named."""
        named = {name: number for number, floor in enumerate(self.floors) for name in floor}
        while part not in named and "." in part:
            part = part.rpartition(".")[0]
        if part in named:
            return named[part]
        raise InputError(f"{self.name}/{part}: has no place in tools/house.py; name its floor there")


#: Each package imports only those before it.
HOUSE = (
    Package(
        "gyrowheel_core",
        "no physics: what every package uses",
        (
            ("errors", "wire", "cache"),
            (
                "arrays",
                "units",
                "files",
                "schema",
                "yaml_text",
                "readings",
                "topics",
                "processes",
                "origin_guard",
            ),
            ("namespaces", "surroundings"),
            ("start_node",),
            ("quantities", "node", "locks"),
            ("journal",),
        ),
    ),
    Package(
        "gyrowheel_sim",
        "physics of the bench",
        (
            ("jit", "environment"),
            ("parameter",),
            ("bench", "instruments"),
            ("effects", "mechanics"),
            ("plant",),
            ("blind",),
        ),
    ),
    Package(
        "gyrowheel_air",
        "torque of the air",
        (
            ("geometry",),
            ("torque",),
            ("correlations", "cfd"),
            ("table",),
            ("flow", "surrogate"),
            ("check", "cfd.sweep"),
            ("compare",),
        ),
    ),
    Package("gyrowheel_control", "loops and test plans", (("plans",), ("loops",), ("nodes",))),
    Package(
        "gyrowheel_recording",
        "bags, tables, column maps",
        (("derived",), ("bags",), ("mislabelled", "tables"), ("mapping",), ("nodes",)),
    ),
    Package(
        "gyrowheel_analysis",
        "from a recording to a verdict",
        (
            ("criteria", "channels", "model"),
            ("reduction", "machines"),
            ("balance",),
            ("fitting", "torques", "capability", "trend"),
            ("residuals",),
            ("diagnosis", "drag", "rate_sensor"),
            ("compare", "add", "calibrate", "compare_models", "compare_sets", "estimation"),
            ("nodes",),
        ),
    ),
    Package(
        "gyrowheel_bringup",
        "the graph of nodes",
        (
            ("graph", "preload", "viewers"),
            ("foxglove_process", "replay_session", "foxglove_node"),
        ),
    ),
    Package(
        "gyrowheel",
        "the front door: import gyrowheel as gw",
        (
            ("show",),
            ("cli",),
            ("recordings",),
            ("catalogue",),
            ("models",),
            ("simulation",),
            ("tables", "comparison", "rate_sensing", "calibration"),
            ("diagnosis", "torque_budget", "momentum_envelope", "drag_comparison"),
            ("graph", "air_flow", "blind_tests", "batches"),
            ("trends",),
            ("investigation", "campaigns"),
            ("report",),
            ("demonstration", "paper_figures", "workbench"),
            ("cli.app",),
        ),
    ),
)

_WIDTH, _LEFT, _RIGHT, _PAD = 860, 190, 16, 10
_PART_HEIGHT, _GAP = 24, 6
#: Fill and edge of each package, ground floor first.
_COLOURS = (
    ("#e8eaed", "#9aa0a6"),
    ("#e3efe0", "#7ba46f"),
    ("#e6f0e8", "#7fa58a"),
    ("#e0eef2", "#6c9fb0"),
    ("#e2ebf6", "#7391b8"),
    ("#e5e6f5", "#7c80bd"),
    ("#f4eadb", "#bd9a62"),
    ("#f5e1e0", "#bd7670"),
)


def _lines(floor: tuple[str, ...]) -> list[list[tuple[str, float]]]:
    """Return the boxes of a floor with their widths, in as many lines as they need."""
    lines: list[list[tuple[str, float]]] = [[]]
    room = whole = float(_WIDTH - _LEFT - 60 - _RIGHT - _PAD)
    for part in floor:
        width = 7.4 * len(part) + 2 * _PAD
        if width > room and lines[-1]:
            lines.append([])
            room = whole
        lines[-1].append((part, width))
        room -= width + _GAP
    return lines


def to_svg() -> str:
    """Return the picture of the house: a box a package, the roof on top, in it its floors.

    Its ground is white whatever the page's is, so that it reads in a light and in a dark theme.
    """
    body: list[str] = []
    y = 54.0
    for package, (fill, edge) in reversed(list(zip(HOUSE, _COLOURS, strict=True))):
        floors = [_lines(floor) for floor in reversed(package.floors)]
        height = sum(map(len, floors)) * (_PART_HEIGHT + _GAP) + 2 * _PAD - _GAP
        body.append(
            f'<rect x="16" y="{y:g}" width="{_WIDTH - 32}" height="{height:g}" rx="6" fill="{fill}" stroke="{edge}"/>'
        )
        body.append(f'<text x="28" y="{y + 22:g}" class="name">{package.name}</text>')
        words = package.about.split(": ")
        for line, text in enumerate(words):
            body.append(f'<text x="28" y="{y + 40 + 15 * line:g}" class="about">{text}</text>')
        line_y = y + _PAD
        for row in (row for lines in floors for row in lines):
            x = float(_LEFT + 60)
            for part, width in row:
                body.append(
                    f'<rect x="{x:g}" y="{line_y:g}" width="{width:g}" height="{_PART_HEIGHT}" rx="4" fill="#ffffff" '
                    f'stroke="{edge}"/>'
                    f'<text x="{x + width / 2:g}" y="{line_y + 16:g}" class="part">{part}</text>'
                )
                x += width + _GAP
            line_y += _PART_HEIGHT + _GAP
        y += max(height, 64.0) + 10
    whole = y + 34
    style = (
        "text{font-family:ui-monospace,Menlo,Consolas,monospace;fill:#202124}"
        ".name{font-size:14px;font-weight:bold}.about{font-size:11px;font-family:sans-serif;fill:#3c4043}"
        ".part{font-size:12px;text-anchor:middle}.note{font-size:12px;font-family:sans-serif}"
    )
    top = (
        '<text x="28" y="32" class="note">'
        "A box imports only what stands below it: packages, and the floors in a package.</text>"
    )
    bottom = (
        f'<text x="28" y="{y + 14:g}" class="note">gyrowheel_msgs (messages, services, action) stands beside it; '
        "only nodes and topics import it.</text>"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{whole:g}" '
        f'viewBox="0 0 {_WIDTH} {whole:g}" '
        f'role="img" aria-label="Packages and folders, each above what it imports"><style>{style}</style>'
        f'<rect width="{_WIDTH}" height="{whole:g}" rx="8" fill="#ffffff"/>\n'
        + "\n".join([top, *body, bottom])
        + "\n</svg>\n"
    )
