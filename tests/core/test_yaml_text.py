"""YAML of users, read strictly."""

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.yaml_text import read_yaml


def test_content_and_anchors_are_read() -> None:
    text = "a: &one {x: 1}\nb: *one\nc: {<<: *one, y: 2}\n"
    assert read_yaml(text, "f") == {"a": {"x": 1}, "b": {"x": 1}, "c": {"x": 1, "y": 2}}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a: 1\na: 2\n", "is here a second time"),
        ("a: [1, 2\n", "expected"),
        ("a: &one [*one]\n", "it refers to itself"),
        ("[" * 5000, "nested too deeply"),
        ("when: 2026-13-45\n", "month must be in"),
        ("a: &a [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\n"
         + "".join(f"{n}: &{n} [{', '.join([f'*{o}'] * 10)}]\n" for o, n in zip("abcdef", "bcdefg", strict=True)),
         "its anchors repeat too much"),
        ("a: &a {x: 1}\n"
         + "".join(f"{n}: &{n} {{<<: [{f'*{o}, ' * 10}]}}\n" for o, n in zip("abcdefg", "bcdefgh", strict=True))
         + "<<: *h\n",
         "its anchors repeat too much"),
        ("a: 1" + ":1" * 2000 + "\n", "a number of 4001 characters"),
    ],
    ids=["key twice", "cut off", "endless", "deep", "no date", "too many", "merged", "base 60"],
)  # fmt: skip
def test_invalid_yaml_is_refused_in_one_line(text: str, why: str) -> None:
    with pytest.raises(InputError) as caught:
        read_yaml(text, "wheel.yaml")
    said = str(caught.value)
    assert said.startswith("wheel.yaml: not valid YAML: ")
    assert why in said
    assert "\n" not in said
