"""Recordings at another rate than the loop's: how fast it is, and what an average of its voltages misses."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel_analysis.reduction.samples import Samples, loop_period, unseen_noise
from gyrowheel_core.readings import READINGS, Readings

from .machines import BENCH

LOOP = 5.0e-4  # s, as the bench states
GAIN = np.array([0.0, 0.0, 4.0e3, -2.5e3, -1.5e3])  # V/rad: a damper with a delay of two samples


def recorded(period: float, *, every: int = 1, logger: float = 0.0) -> tuple[Samples, float]:
    """Return a recording of a loop of some period, of every so many samples of it or at a rate of its own."""
    rng = np.random.default_rng(1)
    n = 12_000
    tilt = 2e-5 * (rng.normal(size=n) + 1j * rng.normal(size=n))
    volts = np.convolve(tilt, GAIN)[:n]
    time = period * np.arange(n)
    if logger:
        now = np.arange(0.0, time[-1], logger)
        rows = np.searchsorted(time, now - 1e-9)
        time, tilt, volts = now, tilt[rows], volts[rows]
    time, tilt, volts = time[::every], tilt[::every], volts[::every]
    volts = volts + BENCH.value("coil_voltage_noise") * (
        rng.normal(size=len(volts)) + 1j * rng.normal(size=len(volts))
    )
    readings = Readings(np.zeros((len(time), len(READINGS))))
    for name, values in (("tilt", tilt), ("coil_voltage", volts)):
        readings[f"{name}_x"][:], readings[f"{name}_y"][:] = values.real, values.imag
    stamps: np.ndarray = np.asarray(time, dtype=np.float64)
    return Samples(stamps, readings, np.zeros(0), np.zeros(0)), float(np.median(np.diff(time)))


@pytest.mark.parametrize(
    ("loop", "how", "found"),
    [
        (LOOP, {}, LOOP),
        (LOOP, {"every": 2}, LOOP),
        (LOOP, {"every": 4}, LOOP),
        (LOOP, {"logger": 1.0 / 1024.0}, LOOP),
        (LOOP, {"logger": 2.0e-4}, LOOP),
        (2.0e-4, {}, 2.0e-4),
        (1.0 / 1200.0, {}, 1.0 / 1200.0),
    ],
)
def test_the_rate_of_the_loop_follows_from_the_samples(
    loop: float, how: dict[str, float], found: float
) -> None:
    samples, period = recorded(loop, **how)  # type: ignore[arg-type]
    assert loop_period(samples, period, BENCH) == pytest.approx(found, rel=0.01)


@pytest.mark.parametrize("every", [1, 2, 4, 2.5])
def test_noise_of_an_average_includes_the_voltages_that_were_not_sampled(every: float) -> None:
    """Averages over windows of some of the samples scatter about those over all by what is said."""
    rng = np.random.default_rng(2)
    volts = 0.15 * (rng.normal(size=(400, 1000)) + 1j * rng.normal(size=(400, 1000)))
    if every == 2.5:  # more samples than voltages
        rows = np.searchsorted(np.arange(1000), np.arange(0.0, 999.0, 1.0 / every) + rng.uniform() - 1e-9)
    else:
        rows = np.arange(0, 1000, int(every))
    shown = volts[:, rows]
    off = shown.mean(axis=1) - volts.mean(axis=1)
    scatter = float(np.sqrt(np.mean(np.abs(off) ** 2) / 2.0))
    samples = len(rows) / 1000.0
    said = unseen_noise((shown - shown.mean(axis=1, keepdims=True)).ravel(), 2e-3, samples) / np.sqrt(
        len(rows)
    )
    if every == 1:
        assert scatter == pytest.approx(0.0, abs=1e-12)
        assert said == pytest.approx(2e-3 / np.sqrt(1000))
    else:  # not too small; the noise of a loop is stronger at high frequencies than this one
        assert scatter < 1.1 * said < 2.2 * scatter


def test_the_period_of_another_rate_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is asked for at every window: an hour at half the bench's rate took minutes for it."""
    data, period = recorded(LOOP, every=2)
    steps, calls = Samples._steps, 0

    def counted(data: Samples) -> np.ndarray:
        nonlocal calls
        calls += 1
        return steps(data)

    monkeypatch.setattr(Samples, "_steps", counted)
    assert [data.period(LOOP) for _ in range(5)] == pytest.approx([period] * 5)
    assert calls == 2
