"""The momentum envelope: data against the kinematics and against the figures of the paper, and its pictures."""

from __future__ import annotations

import io
import json
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from gyrowheel.momentum_envelope.picture import body_figure, caps_figure
from gyrowheel.show.figure import png_bytes
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics.kinematics import envelope, speeds_of
from tools.docs import momentum_csv, momentum_numbers

EACH_BENCH = pytest.mark.parametrize(
    "bench", [Bench.load(name) for name in Bench.shipped()], ids=lambda bench: bench.name
)


def test_default_speeds_and_tilts_equal_those_of_the_paper() -> None:
    found = envelope(Bench.load())
    np.testing.assert_allclose(found.speed / RPM, [3000.0, 3500.0, 4000.0], rtol=1e-12)
    assert found.tilt[-1] == pytest.approx(5.0 * DEG)
    # 1.779e-3 kg m^2 at 4000 rpm
    assert found.approximate[2, 0, 0, 2] == pytest.approx(0.7452, abs=1e-4)
    np.testing.assert_allclose(found.error_last[[1, 3, 5]], [1.5e-4, 1.4e-3, 3.8e-3], rtol=0.03)
    np.testing.assert_allclose(found.error_middle[[1, 3, 5]], [0.0104, 0.0313, 0.0524], rtol=3e-3)


@EACH_BENCH
def test_caps_are_parts_of_spheres_and_the_mean_of_the_exact_momentum(bench: Bench) -> None:
    found = envelope(bench)
    radius = bench.value("rotor_inertia_z") * found.speed
    sizes = np.linalg.norm(found.approximate, axis=-1)
    np.testing.assert_allclose(sizes, np.broadcast_to(radius[:, None, None], sizes.shape), rtol=1e-12)
    np.testing.assert_allclose(found.exact_mean, found.approximate, atol=1e-10 * radius[-1])
    # the exact momentum ripples about it, by 1/cos(phi) up and cos(phi) down
    for extreme, factor in ((found.largest, 1.0 / np.cos(found.tilt)), (found.smallest, np.cos(found.tilt))):
        expected = radius[:, None, None] * factor[None, :, None]
        np.testing.assert_allclose(extreme, np.broadcast_to(expected, extreme.shape), rtol=1e-6)
    np.testing.assert_allclose(found.error_last, 1.0 / np.cos(found.tilt) - 1.0, rtol=5e-3, atol=1e-12)


@EACH_BENCH
def test_csv_and_json_contain_the_envelope(bench: Bench) -> None:
    found = envelope(bench)
    head, *rows = momentum_csv(found).splitlines()
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    assert table.shape == (3 * (5 * 12 + 1), len(head.split(",")))
    np.testing.assert_allclose(
        np.linalg.norm(table[:, 3:6], axis=1), bench.value("rotor_inertia_z") * table[:, 0], rtol=1e-5
    )
    assert np.all(table[:, 9] <= table[:, 10])
    content = json.loads(json.dumps(momentum_numbers(found)))
    assert np.shape(content["along_axis"]) == (3, 6)
    assert content["across_axis"][0][0] == 0.0


def test_speeds_can_be_chosen() -> None:
    found = envelope(Bench.load(), [100.0, 200.0])
    assert found.approximate.shape == (2, 6, 12, 3)
    np.testing.assert_allclose(found.approximate[1], 2.0 * found.approximate[0])
    assert len(speeds_of(Bench.load())) == 3


@EACH_BENCH
@pytest.mark.parametrize("draw", [caps_figure, body_figure], ids=["caps", "body"])
def test_pictures_are_drawn_and_embed_their_numbers(bench: Bench, draw: Callable[[Bench], Figure]) -> None:
    with Image.open(io.BytesIO(png_bytes(draw(bench), '{"a": 1}'))) as image:
        assert image.info["Description"] == '{"a": 1}'
        assert image.size[0] > 1000
        pixels = np.asarray(image.convert("L"))
    # something is drawn, and on white
    assert 0.02 < float((pixels < 200).mean()) < 0.6
