"""YAML as the files of users have it: read strictly, so that nothing in them is silently passed over."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Final

import yaml

from gyrowheel_core.errors import InputError, one_line

#: Values in a file, counted as often as anchors repeat them; more are taken for a trap.
_MOST: Final = 1_000_000
_LONGEST: Final = 200  # characters of what the parser says


# The loader in C is quicker, but a text that is nested deeply enough crashes it.
class _Loader(yaml.SafeLoader):
    """Refuses a key that stands twice in a mapping, of which YAML libraries keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        result = super().construct_mapping(node, deep)
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key!r} stands here a second time", key_node.start_mark
                )
            seen.add(key)
        return result


def read_yaml(text: str, origin: str) -> Any:
    """Return the content of a YAML text.

    Parameters
    ----------
    text : str
        The text.
    origin : str
        Where it comes from, for the error.

    Raises
    ------
    InputError
        If it is no YAML, has a key twice in one mapping, or refers to itself without end.
    """
    try:
        content = yaml.load(text, _Loader)
        _expanded(content, {})
    except yaml.YAMLError as error:
        raise InputError(f"{origin}: not valid YAML: {one_line(error)[:_LONGEST]}") from None
    except RecursionError:
        raise InputError(f"{origin}: not valid YAML: nested too deeply") from None
    except (ValueError, OverflowError, TypeError, AttributeError, KeyError, IndexError) as error:
        # what the constructors of dates and numbers let through
        raise InputError(f"{origin}: not valid YAML: {one_line(error)[:_LONGEST]}") from None
    return content


def _expanded(content: Any, known: dict[int, int]) -> int:
    """Return how many values there are when every anchor is written out; too many, or endless, are refused."""
    if not isinstance(content, dict | list | set | tuple):
        return 1
    if id(content) in known:
        if known[id(content)] < 0:
            raise ValueError("it refers to itself")
        return known[id(content)]
    known[id(content)] = -1
    count = 1
    for value in content.values() if isinstance(content, dict) else content:
        count += _expanded(value, known)
        if count > _MOST:
            raise ValueError("its anchors repeat too much")
    known[id(content)] = count
    return count
