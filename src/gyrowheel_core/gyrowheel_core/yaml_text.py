"""Strict reading of users' YAML files: nothing in them is silently ignored."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Final

import yaml

from gyrowheel_core.errors import InputError, one_line

#: Largest number of values in a file with its anchors written out; more would exhaust the memory.
_MOST: Final = 1_000_000
_LONGEST: Final = 200  # characters of the parser's message
#: Characters that a text may have; the parser takes six seconds for as many.
LARGEST: Final = 1_000_000
_MERGE: Final = "tag:yaml.org,2002:merge"
_DIGITS: Final = 1000  # characters of a whole number; YAML reads 1:1:1 in base 60, one part after the other


# The loader in C is faster, but deep nesting crashes it.
class _Loader(yaml.SafeLoader):
    """A loader that refuses a repeated key in a mapping; YAML libraries keep the last one."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._merged = 0  # keys that came from other mappings

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Write out the mappings that are merged into one, unless they are too many: each may have others in it."""
        for key, value in node.value:
            if key.tag != _MERGE:
                continue
            for part in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                if isinstance(part, yaml.MappingNode):
                    self.flatten_mapping(part)
                    self._merged += len(part.value)
                if self._merged > _MOST:
                    raise yaml.constructor.ConstructorError(
                        None, None, "its anchors repeat too much", key.start_mark
                    )
        super().flatten_mapping(node)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Return a whole number, unless it is far longer than any."""
        if len(node.value) > _DIGITS:
            raise yaml.constructor.ConstructorError(
                None, None, f"a number of {len(node.value)} characters", node.start_mark
            )
        return super().construct_yaml_int(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        result = super().construct_mapping(node, deep)
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            if key_node.tag == _MERGE:
                continue
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key!r} is here a second time", key_node.start_mark
                )
            seen.add(key)
        return result


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


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
        If it is not YAML, has a key twice in one mapping, refers to itself, or is far longer than any file of this
        project.
    """
    if len(text) > LARGEST:
        raise InputError(f"{origin}: has {len(text)} characters; allowed: up to {LARGEST}")
    try:
        content = yaml.load(text, _Loader)
        _expanded(content, {})
    except yaml.YAMLError as error:
        raise InputError(f"{origin}: not valid YAML: {one_line(error)[:_LONGEST]}") from None
    except RecursionError:
        raise InputError(f"{origin}: not valid YAML: nested too deeply") from None
    except (ValueError, OverflowError, TypeError, AttributeError, KeyError, IndexError) as error:
        # errors that the constructors of dates and numbers do not catch
        raise InputError(f"{origin}: not valid YAML: {one_line(error)[:_LONGEST]}") from None
    return content


def _expanded(content: Any, known: dict[int, int]) -> int:
    """Return the number of values with every anchor written out; refuse too many, or an endless repetition."""
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


def lines(text: str) -> dict[tuple[str, ...], int]:
    """Return the lines, from 1, on which the keys and list items of a YAML text stand.

    A place is the keys and the numbers of list items on the way to it; what an anchor brings in has no place of its
    own. The text must be one that `read_yaml` takes.
    """
    found: dict[tuple[str, ...], int] = {}

    def walk(node: yaml.Node, place: tuple[str, ...]) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                below = (*place, str(key.value))
                found[below] = key.start_mark.line + 1
                walk(value, below)
        elif isinstance(node, yaml.SequenceNode):
            for index, item in enumerate(node.value):
                below = (*place, str(index))
                found[below] = item.start_mark.line + 1
                walk(item, below)

    root = yaml.compose(text, _Loader)
    if root is not None:
        walk(root, ())
    return found
