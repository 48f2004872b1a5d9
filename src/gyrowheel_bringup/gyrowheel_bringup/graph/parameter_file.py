"""Parameters of nodes as files of ROS, and on its command line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import yaml

EVERY_NODE = "/**"


class _Dumper(yaml.SafeDumper):
    """Writes every text in quotes: ROS takes 3e32 without them for a number, while to this library it is a text."""


_Dumper.add_representer(
    str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"')
)


def write_parameters(file: Path, parameters: Mapping[str, object], node: str = EVERY_NODE) -> None:
    """Write parameters into a file for ``--params-file``.

    Parameters
    ----------
    file : Path
        The file.
    parameters : mapping
        Values by name; each has the type in the node that it has here.
    node : str
        Full name of the node that they are for.
    """
    content = {node: {"ros__parameters": dict(parameters)}}
    file.write_text(yaml.dump(content, Dumper=_Dumper), encoding="utf-8")


def text_rule(name: str, text: str) -> str:
    """Return what stands behind ``-p`` for a parameter that is a text, whatever it looks like."""
    return f"{name}:={json.dumps(text, ensure_ascii=False)}"
