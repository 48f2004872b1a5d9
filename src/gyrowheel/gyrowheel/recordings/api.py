"""A recording of the bench: opened, simulated, salvaged or corrected."""

from __future__ import annotations

import contextlib
import math
import shlex
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.result import Shown
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import read_beginning, write_text
from gyrowheel_recording.bags import Recording as Data
from gyrowheel_recording.bags.metadata import METADATA_FILE

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Integrity, RecordingInfo, Salvaged
    from gyrowheel_recording.mislabelled import WrongSetup
    from gyrowheel_sim.environment import Environment

FOLDER = ".machines"  # of the notes on simulated machines
_LONGEST = 4096  # characters of a note


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
            A rosbag2 directory of any storage, or one of its files. A suffix ``@from=20,until=110`` selects a part
            [s from its start]: only its steady motion is compared with models.

        Raises
        ------
        InputError
            If it does not exist, is incomplete or damaged, has no measurements, or has no such part.
        """
        return cls(Path(path), Data.open(path))

    @classmethod
    def all(cls, folder: str | Path) -> list[Recording]:
        """Read every recording in a folder, in the order of their names; all else in it is left out.

        Raises
        ------
        InputError
            If there is no such folder, or a recording in it is incomplete or damaged.
        """
        place = Path(folder)
        if not place.is_dir():
            raise InputError(f"{folder}: no such folder")
        return [cls.open(own) for own in sorted(place.iterdir()) if (own / METADATA_FILE).is_file()]

    @classmethod
    def made(cls, path: Path, keep: object = None) -> Recording:
        """Return a recording that was just written; it is read at its first use.

        Its folder may be temporary: it exists as long as `keep` does, which the recording refers to.
        """
        return cls(path, keep=keep)

    @classmethod
    def written(cls, folder: str | Path | None, name: str, write: Callable[[Path], object]) -> Recording:
        """Return the recording that a function writes into a new folder; without one into a temporary one.

        The temporary one has the name, and is removed with the recording.
        """
        if folder is not None:
            write(Path(folder))
            return cls.made(Path(folder))
        scratch = tempfile.TemporaryDirectory(prefix="gyrowheel-")
        place = Path(scratch.name) / name
        write(place)
        return cls.made(place, scratch)

    def part(self, start: float = -math.inf, end: float = math.inf) -> Recording:
        """Return a part of it, as the suffix ``@from=`` and ``@until=`` of a path selects; it shares its samples.

        Parameters
        ----------
        start, end : float
            Times from the start of the recording [s].

        Raises
        ------
        InputError
            If there is nothing of it between these times.
        """
        data = self.data.within(float(start), float(end))
        return Recording(data.path, data, self._keep)

    @property
    def data(self) -> Data:
        """The recording as the packages below have it."""
        if self._opened is None:
            self._opened = Data.open(self._path)
        return self._opened

    @property
    def machine(self) -> str:
        """Name of the machine, as its environment states it; empty where unknown."""
        return Data.machine_of(self._path) if self._opened is None else self._opened.machine

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
        return self.data.duration

    @property
    def time(self) -> NDArray[np.float64]:
        """Times of the samples since the first one [s], shape (n,)."""
        return _read_only(self.data.time)

    @property
    def measurement(self) -> NDArray[Any]:
        """Samples, a structured array of shape (n,); columns by name, such as ``measurement["tilt_x"]``.

        ``stamp_ns`` [ns], ``sequence``, ``tilt_x``, ``tilt_y`` [rad], ``spin_angle`` [rad, 0 .. 2π), ``spin_rate``
        [rad/s], ``coil_voltage_x``, ``coil_voltage_y``, ``motor_voltage`` [V], ``motor_current`` [A],
        ``coil_temperature``, ``air_temperature`` [K], ``air_pressure`` [Pa].
        """
        return _read_only(self.data.measurement)

    @property
    def commands(self) -> NDArray[Any]:
        """Commands of the controller, a structured array; of length 0 if they were not recorded.

        ``stamp_ns`` [ns], ``measurement_sequence``, ``coil_voltage_x``, ``coil_voltage_y``, ``motor_voltage`` [V].
        """
        return _read_only(self.data.command)

    @property
    def setpoints(self) -> NDArray[Any]:
        """Setpoints of the test plan, a structured array; of length 0 if they were not recorded.

        ``stamp_ns`` [ns], ``segment``, ``phase`` (0 ramp, 1 hold), ``tilt_x``, ``tilt_y`` [rad], ``tilt_rate_x``,
        ``tilt_rate_y`` [rad/s], ``spin_rate`` [rad/s], ``spin_acceleration`` [rad/s²].
        """
        return _read_only(self.data.setpoint)

    @property
    def environment(self) -> tuple[Environment, ...]:
        """Planned air and attitude of the rig, with times since the first sample; empty if unknown."""
        return tuple(self.data.environment)

    @property
    def integrity(self) -> Integrity:
        """Missing, duplicate, late and non-finite samples."""
        return self.data.integrity()

    @cached_property
    def info(self) -> RecordingInfo:
        """Summary of the content: ``.bench``, ``.rate``, ``.holds``, ``.topics``, ``.integrity`` and more."""
        from gyrowheel_recording.bags import info

        return info(self.data)

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

        return recording_figure(self.data)

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
        return len(self.data.measurement)

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
        The salvaged and the missing parts.

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


def correct(
    recording: Recording | str | Path,
    *,
    exchange: Sequence[tuple[str, str]] = (),
    scale: Mapping[str, float] | None = None,
    offset: Mapping[str, float] | None = None,
    shift: Mapping[str, float] | None = None,
    without: Sequence[str] = (),
    every: float = 1,
    folder: str | Path | None = None,
) -> Recording:
    """Return a copy of a recording with corrected readings.

    Parameters
    ----------
    recording : Recording or path
        The recording; it is not changed.
    exchange : sequence of (str, str)
        Pairs of readings to exchange, before all else.
    scale, offset : mapping, optional
        Readings to multiply, then to increase [SI].
    shift : mapping, optional
        Readings to move to later times [s]; samples without a shifted reading are dropped.
    without : sequence of str
        Readings to leave out, as if they had not been measured.
    every : float
        Of so many samples one is kept: that in which a reading that is held so long is new.
    folder : str or Path, optional
        New directory to keep it in; a temporary one that is removed with the recording if not given.

    Raises
    ------
    InputError
        If a reading is unknown, a value is not allowed, there is nothing to correct, or the folder cannot be written.
    """
    from gyrowheel_core.files import new_directory, require_new
    from gyrowheel_recording.mislabelled import Fix
    from gyrowheel_recording.mislabelled import correct as write_corrected

    if folder is not None:
        require_new(Path(folder))
    given = recording if isinstance(recording, Recording) else Recording.open(recording)
    cure = Fix(
        tuple(exchange), dict(scale or {}), dict(offset or {}), dict(shift or {}), tuple(without), every
    )

    def write(place: Path) -> None:
        with new_directory(place) as new:
            write_corrected(given.data, cure, new)

    return Recording.written(folder, f"{given.name}-corrected", write)


def wrong_setups(recordings: Sequence[Recording], model: Model, *, mixed: bool = False) -> list[WrongSetup]:
    """Return the wrong setups of recordings: columns that cannot be what they are called."""
    from gyrowheel_recording.mislabelled.find import wrong_setups as find

    return find([recording.data for recording in recordings], model.reference_bench, mixed=mixed)


def refuse_wrong_setups(recordings: Sequence[Recording], model: Model, *, mixed: bool = False) -> None:
    """Refuse recordings with columns that cannot be what they are called; InputError names them."""
    if wrong := wrong_setups(recordings, model, mixed=mixed):
        from gyrowheel.show.sentences.setup import setup_line

        raise InputError(setup_line(wrong))


@contextlib.contextmanager
def explained_by(wrong: Sequence[WrongSetup]) -> Iterator[None]:
    """Report a wrong setup instead of an error that it causes."""
    try:
        yield
    except InputError as error:
        if not wrong:
            raise
        from gyrowheel.show.sentences.setup import setup_line

        raise InputError(setup_line(wrong)) from error


def note_machine(recording: Recording, options: Sequence[str]) -> None:
    """Write a note next to a recording: the options of the command line that define its simulated machine.

    It is a file of the machine's name in the folder ``.machines``; of a hidden machine it has the name of the key
    file. No analysis reads it: it is for the command to type next, so that the next test runs on the same machine.
    """
    place = _place(recording) if options else None
    if place is not None:
        place.parent.mkdir(exist_ok=True)
        write_text(place, shlex.join(options) + "\n")


def noted_machine(recordings: Sequence[Recording]) -> str:
    """Return the options of the machine of some recordings from their notes; empty without a note."""
    for recording in recordings:
        place = _place(recording)
        try:
            note = "" if place is None else read_beginning(place, _LONGEST).decode("utf-8").strip()
            if note and note.isprintable():
                return shlex.join(shlex.split(note))  # quoted: never another command
        except (OSError, ValueError):
            continue
    return ""


def machine_options(
    *,
    effect: Sequence[str] | None = None,
    truth: Path | None = None,
    blind: Path | None = None,
    machine: int | None = None,
    seed: int = 0,
    bench: str | None = None,
) -> list[str]:
    """Return the options of the command line for a machine, as the user gave them."""
    words = [word for item in effect or () for word in ("--effect", item)]
    for name, value in (("truth", truth), ("blind", blind), ("machine", machine), ("bench", bench)):
        words += [] if value is None else [f"--{name}", str(value)]
    return [*words, "--seed", str(seed)] if seed else words


def _place(recording: Recording) -> Path | None:
    """Return the file of the note; None for a recording without the name of a machine."""
    name = recording.machine
    return recording.path.absolute().parent / FOLDER / name if name.isalnum() else None
