"""Key files of hidden machines: what is none is refused in one line that says why."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import reuse_or_draw


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", ["values: missing", "name a new file"]),
        ("[]", ["a mapping with values, effects", "name a new file"]),
        ("schema: 1\n", ["not valid JSON (line 1, column 1)", "name a new file"]),
        ('{"values": {}, "effects": {"windage": 3}}', ["effects.windage", "3"]),
        ('{"values": {}, "effects": {"windage": {"w": "a"}}}', ["effects.windage.w", "'a'"]),
        ('{"values": {}, "effects": {"windge": {}}}', ["effects", "windge", "windage"]),
        ('{"values": {"nosuch": 1}, "effects": {}}', ["values.nosuch"]),
        ('{"values": {"rotor_inertia_z": "a"}, "effects": {}}', ["values", "rotor_inertia_z"]),
    ],
)
def test_invalid_key_file_is_refused(tmp_path: Path, text: str, words: list[str]):
    key = tmp_path / "key.json"
    key.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        reuse_or_draw(Bench.load(), key, 1)
    message = str(caught.value)
    assert message.startswith(f"{key}: ")
    assert all(word in message for word in words)
    assert "Expecting" not in message


@pytest.mark.parametrize("kind", ["none", "single", "pair", "outside"])
def test_every_drawn_key_is_read_back(tmp_path: Path, kind: str):
    bench, key = Bench.load(), tmp_path / "key.json"
    for seed in range(12):
        key.unlink(missing_ok=True)
        drawn = reuse_or_draw(bench, key, seed, kinds=[kind])  # type: ignore[list-item]
        again = reuse_or_draw(bench, key, seed + 1)
        assert again.values == pytest.approx(drawn.values)
        assert again.effects == drawn.effects == json.loads(key.read_text())["effects"]
