"""What the samples themselves show of the instruments: hum, steps of the converters, and the clock.

None of it turns a torque. It makes the rows of the balance noisier, each as far as it is there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrowheel_analysis.reduction.hum import Line, find_lines, hum_variance, untold
from gyrowheel_analysis.reduction.lattice import steps
from gyrowheel_analysis.reduction.quality import READING_NOISES, readable
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.stamps import Stamps, read_stamps
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_sim.bench import Bench

_UNIFORM = 12.0  # variance of rounding: step² over this


@dataclass(frozen=True)
class Shown:
    """What the samples of a recording show of its instruments.

    Attributes
    ----------
    lines : tuple of Line
        Hum at multiples of the mains; that at the stated frequency in any case where it can be told.
    untold : str
        Why hum at the stated frequency cannot be told, as `hum.untold` returns it.
    steps : dict of str to float
        Step of each reading that changes by whole steps, by reading [SI].
    noise : dict of str to float
        White noise of the readings, by its name in the bench file [SI].
    stamps : Stamps or None
        What the stamps show of the clock.
    spin : float
        Highest speed of the steady motion [rad/s].
    commanded : bool
        Whether the commands are known, beside which the noise of the coil voltages is measured.
    """

    lines: tuple[Line, ...] = ()
    untold: str = ""
    steps: dict[str, float] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    stamps: Stamps | None = None
    spin: float = 0.0
    commanded: bool = False

    def weighed(self, windows: Windows, elsewhere: Sequence[Shown] = ()) -> Windows:
        """Return the windows with the noise that hum and steps add.

        The rounding is in the noise of a reading where that is measured: not of the coil voltages without commands.

        Parameters
        ----------
        windows : Windows
            The windows.
        elsewhere : sequence of Shown
            What other recordings of the machine show: their hum is there too, even where a speed of this recording
            covers it.
        """
        if not len(windows):
            return windows
        noise = windows.reading_noise.copy()
        step = max(self.steps.get(f"coil_voltage_{axis}", 0.0) for axis in "xy")
        k = READING_NOISES.index("coil_voltage_noise")
        if not self.commanded:
            noise[:, k] = np.sqrt(noise[:, k] ** 2 + step**2 / _UNIFORM)
        return replace(
            windows, reading_noise=noise, hum_variance=hum_variance(self._lines_with(elsewhere), windows)
        )

    def _lines_with(self, elsewhere: Sequence[Shown]) -> list[Line]:
        """Return its lines, and what other recordings show beyond them; of several the first."""
        lines = list(self.lines)
        for line in (line for other in elsewhere for line in other.lines):
            told = {
                channel
                for own in lines
                if (own.mains, own.multiple) == (line.mains, line.multiple)
                for channel in own.found
            }
            if further := line.found - told:
                lines.append(replace(line, found=further))
        return lines


def look(data: Samples, windows: Windows, bench: Bench) -> Shown:
    """Look at what samples show of the instruments.

    Parameters
    ----------
    data : Samples
        The recording.
    windows : Windows
        Its steady windows.
    bench : Bench
        The bench as stated.
    """
    period = data.period(bench.sample_period)
    stamps = None if data.sequence is None else read_stamps(data, data.sequence, period)
    if stamps is not None and period != bench.sample_period:
        stamps = replace(stamps, stated=stamps.period)  # nothing states the rate of another logger
    if not len(windows):
        return Shown(stamps=stamps)
    if data.absent:
        data, _, _ = readable(data, bench)
    return Shown(
        tuple(find_lines(data, windows, bench)),
        untold(windows, bench.value("mains_frequency")),
        steps(data.readings),
        dict(zip(READING_NOISES, windows.reading_noise[0].tolist(), strict=True)),
        stamps,
        float(windows.mean_spin.max()),
        data.commanded is not None,
    )
