"""A recording of the bench, opened or simulated."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.result import Shown
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording as Data

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_recording.bags import Integrity, RecordingInfo, Salvaged
    from gyrowheel_sim.environment import Environment


class Recording(Shown):
    """A recording in memory; its arrays are in order of time, in SI units, and read-only.

    Returned by `Recording.open`, `gyrowheel.simulate`, `gyrowheel.salvage` or `gyrowheel.read_table`.
    """

    def __init__(self, path: Path, data: Data | None = None, keep: object = None) -> None:
        self._path = path
        self._opened = data
        self._keep = keep  # lives as long as the recording: the temporary folder of a simulated one

    @classmethod
    def open(cls, path: str | Path) -> Recording:
        """Read a recording.

        Parameters
        ----------
        path : str or Path
            A rosbag2 directory of any storage, or one of its files. ``@from=20,until=110`` behind it means that part
            of it [s from its start]: what compares it with a model then looks for steady motion there alone.

        Raises
        ------
        InputError
            If it does not exist, is incomplete or damaged, has no measurements, or has no such part.
        """
        return cls(Path(path), Data.open(path))

    @classmethod
    def made(cls, path: Path, keep: object = None) -> Recording:
        """Return a recording that was just written; it is read at its first use.

        Its folder may be temporary: it exists as long as `keep` does, which the recording refers to.
        """
        return cls(path, keep=keep)

    @property
    def _data(self) -> Data:
        if self._opened is None:
            self._opened = Data.open(self._path)
        return self._opened

    @property
    def data(self) -> Data:
        """The recording as the analysis package has it."""
        return self._data

    @property
    def path(self) -> Path:
        """Path that it was read from; a temporary folder if it was simulated or imported without naming one."""
        return self._path

    @property
    def name(self) -> str:
        """Name of its directory or file."""
        return self._path.absolute().name

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return self._data.duration

    @property
    def time(self) -> NDArray[np.float64]:
        """Times of the samples since the first one [s], shape (n,)."""
        return _read_only(self._data.time)

    @property
    def measurement(self) -> NDArray[Any]:
        """Samples, a structured array of shape (n,); columns by name, such as ``measurement["tilt_x"]``.

        ``stamp_ns`` [ns], ``sequence``, ``tilt_x``, ``tilt_y`` [rad], ``spin_angle`` [rad, 0 .. 2π), ``spin_rate``
        [rad/s], ``coil_voltage_x``, ``coil_voltage_y``, ``motor_voltage`` [V], ``motor_current`` [A],
        ``coil_temperature``, ``air_temperature`` [K], ``air_pressure`` [Pa].
        """
        return _read_only(self._data.measurement)

    @property
    def commands(self) -> NDArray[Any]:
        """Commands of the controller, a structured array; of length 0 if they were not recorded.

        ``stamp_ns`` [ns], ``measurement_sequence``, ``coil_voltage_x``, ``coil_voltage_y``, ``motor_voltage`` [V].
        """
        return _read_only(self._data.command)

    @property
    def setpoints(self) -> NDArray[Any]:
        """Setpoints of the test plan, a structured array; of length 0 if they were not recorded.

        ``stamp_ns`` [ns], ``segment``, ``phase`` (0 ramp, 1 hold), ``tilt_x``, ``tilt_y`` [rad], ``tilt_rate_x``,
        ``tilt_rate_y`` [rad/s], ``spin_rate`` [rad/s], ``spin_acceleration`` [rad/s²].
        """
        return _read_only(self._data.setpoint)

    @property
    def environment(self) -> tuple[Environment, ...]:
        """Planned air and attitude of the rig, with times since the first sample; empty if unknown."""
        return tuple(self._data.environment)

    @property
    def integrity(self) -> Integrity:
        """Missing, duplicate, late and non-finite samples."""
        return self._data.integrity()

    @cached_property
    def info(self) -> RecordingInfo:
        """Summary of the content: ``.bench``, ``.rate``, ``.holds``, ``.topics``, ``.integrity`` and more."""
        from gyrowheel_recording.bags import info

        return info(self._data)

    def to_dict(self) -> dict[str, Any]:
        """Return `info` as ``gyrowheel info --json`` writes it."""
        from dataclasses import asdict

        return {"schema": 1, **asdict(self.info)}

    def to_columns(self) -> Mapping[str, NDArray[Any]]:
        """Return time [s] and every column of `measurement` as arrays of shape (n,)."""
        samples = self.measurement
        return {"time": self.time} | {name: samples[name] for name in samples.dtype.names or ()}

    def plot(self) -> Figure:
        """Return tilt, spin rate, voltages and motor current over time as a matplotlib figure."""
        from gyrowheel.recordings.picture import recording_figure

        return recording_figure(self._data)

    def save(self, folder: str | Path) -> Recording:
        """Write a copy of the recording.

        Parameters
        ----------
        folder : str or Path
            Folder to create; it must not exist, or be empty, and appears complete or not at all.

        Returns
        -------
        Recording
            The same recording at its new path.

        Raises
        ------
        InputError
            If the folder is not new or cannot be written, or the recording is a single file or a part of one.
        """
        from gyrowheel_core.files import disk_errors, new_directory

        if not self.path.is_dir():
            raise InputError(
                f"{self.path}: is a single file or a part; save copies whole recordings (salvage makes one)"
            )
        with new_directory(Path(folder)) as place, disk_errors(Path(folder)):
            shutil.copytree(self.path, place)
        return Recording.open(folder)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self._data.measurement)

    def headline(self) -> str:
        """Return name, length and number of samples."""
        return f"{self.name}, {self.duration:.2f} s, {len(self)} samples"

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.recordings.page import info_page

        return info_page(self.info)


def salvage(
    source: str | Path,
    target: str | Path,
    *,
    every_file: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Salvaged:
    """Make a complete recording from the readable part of a damaged one.

    Parameters
    ----------
    source : str or Path
        An MCAP file, or a directory with such files; it is not changed.
    target : str or Path
        Directory to create; it must not exist, or be empty. It appears when it is complete.
    every_file : bool
        Whether to take files too that ``metadata.yaml`` does not name, which are left out otherwise.
    progress : callable, optional
        Called with the fraction done, 0 .. 1.

    Returns
    -------
    Salvaged
        What was salvaged and what is missing.

    Raises
    ------
    InputError
        If nothing can be salvaged, the recording is still being written, or the new one cannot be written.
    """
    from gyrowheel_recording.bags import salvage as save

    return save(source, target, every_file=every_file, progress=progress)


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    view = values.view()
    view.flags.writeable = False
    return view
