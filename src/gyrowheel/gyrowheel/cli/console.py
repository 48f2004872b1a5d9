"""Shared by all verbs: exit codes, one-line errors, consoles, progress, results."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import IO, TYPE_CHECKING, Any, TextIO, cast

import typer

from gyrowheel_core.errors import InputError, one_line, printable, visible

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from gyrowheel.show.result import Shown


OK, FINDING, BAD_INPUT, NODE_FAILED, INTERNAL_ERROR, INTERRUPTED = 0, 1, 2, 3, 70, 130
#: The reader of the output has closed it: the code of a process ended by SIGPIPE, which no script takes for a result.
CUT_OFF = 141

#: Words for limits of values and kinds of numbers.
_LIMITS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
_NUMBERS = {"int": "whole numbers", "float": "numbers"}
_BLIND = "--blind"
_COMPILER = ("numba.", "llvmlite.")  # as names of its modules begin
_AGAIN = 0.05  # s, after which it is looked at again whether the compiler works
_TRAILING = re.compile(r" +$", re.MULTILINE)

#: Shows a line of progress.
Say = Callable[[str], None]
#: Shows the fraction done, 0 .. 1.
Fraction = Callable[[float], None]


def run(app: typer.Typer, arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; errors of the user become one line on stderr."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # of overflows from absurd readings: the result shows the consequence
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    _open_standard_streams()
    try:
        _refuse_empty(given)
        given = _with_key(given)
        result = _command(app).main(given or ["--help"], prog_name="gyrowheel", standalone_mode=False)
        sys.stdout.flush()
        if result == INTERRUPTED:
            raise KeyboardInterrupt
        return result if isinstance(result, int) else OK
    except InputError as error:
        return bad_input(str(error))
    except typer.TyperException as error:
        return _usage(error)
    except (KeyboardInterrupt, typer.Abort):
        _tell("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        return _cut_off()
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # rich and typer end with 1, which is a finding
            return _cut_off()
        raise
    except Exception as error:
        return _failed(error)


@functools.cache  # typer builds all verbs for every call
def _command(app: typer.Typer) -> typer.core.TyperCommand | typer.core.TyperGroup:
    return cast("typer.core.TyperCommand | typer.core.TyperGroup", typer.main.get_command(app))


def _cut_off() -> int:
    """Discard the buffers, after the reader of the output has closed it."""
    for number, stream in ((1, sys.stdout), (2, sys.stderr)):
        try:
            stream.flush()
        except OSError:
            _drop(number)
    return CUT_OFF


def _tell(line: str) -> None:
    """Write a line to stderr; ignore a closed stderr, as an error would end the process with 1, a finding."""
    try:
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
    except OSError:
        _drop(2)


def _drop(number: int) -> None:
    """Redirect a standard stream to nowhere, so that flushing it at exit does not fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, number)
    os.close(nowhere)


def _open_standard_streams() -> None:
    """Open closed standard streams: else the next file takes the number of one, and output goes into it."""
    for number, name, way in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        with contextlib.suppress(OSError):
            os.fstat(number)
            continue
        opened = os.open(os.devnull, os.O_RDWR)
        if opened != number:
            os.dup2(opened, number)
            os.close(opened)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, way, closefd=False))  # noqa: SIM115


def _failed(error: Exception) -> int:
    """Report an error that the user did not cause, and return its exit code."""
    # the module is heavy: without its import there is no such error
    graph = sys.modules.get("gyrowheel_bringup.graph")
    if graph is not None and isinstance(error, graph.GraphError):
        # it may quote names of foreign nodes on the network
        for line in (f"error: {one_line(error)}", *error.report.splitlines()):
            _tell(printable(line))
        return NODE_FAILED
    from gyrowheel.cli.internal_errors import foreign_package, internal_error, machine_error

    if (said := machine_error(error) or foreign_package(error)) is not None:
        return bad_input(said)
    _tell(f"error: {internal_error(error)}")
    return INTERNAL_ERROR


def finding(asked: bool) -> None:
    """End with the exit code of a finding if the user asked for it."""
    if asked:
        raise typer.Exit(FINDING)


@functools.cache
def out() -> Console:
    """Return the console of the results."""
    return _console(stderr=False)


@functools.cache
def notes() -> Console:
    """Return the console of progress and messages."""
    return _console(stderr=True)


def warn_of(setup: Sequence[Any]) -> None:
    """Warn on stderr of a wrong setup of a recording."""
    if setup:
        from gyrowheel.show.sentences.setup import setup_line

        notes().print(f"warning: {setup_line(setup)}", soft_wrap=True, highlight=False, style="yellow")


def warn_of_changes(recordings: Sequence[Any]) -> None:
    """Warn on stderr of recordings that were changed after they were read: the result is of what was read."""
    for own in recordings:
        if own.data.is_changed:
            text = f"warning: {own.path} was changed after it was read; the result is of what was read"
            notes().print(text, soft_wrap=True, highlight=False, style="yellow")


def put(
    result: Shown,
    json: str | None,
    picture: Path | None = None,
    *,
    page: Iterable[RenderableType] | None = None,
    after: Iterable[RenderableType] = (),
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write a result: its page to stdout, its JSON and its picture where they were asked for.

    `json` and `picture` are the values of the options; with ``--json -`` the JSON replaces the page. `page` replaces
    that of the result where options of the verb change it, `after` follows it, such as the command to type next, and
    `more` adds fields to the JSON.
    """
    shown = itertools.chain(result.page() if page is None else page, after)
    put_content(json, result.to_dict() | dict(more or {}) if json is not None else None, shown)
    put_picture(picture, result.plot, quiet=json == "-")


def put_content(json: str | None, content: Any, page: Iterable[RenderableType]) -> None:
    """Write a page to stdout and content as JSON where it was asked for; with ``-`` the JSON instead of the page."""
    if json is not None:
        put_json(json, content)
    if json != "-":
        put_text(page)


def put_text(parts: Iterable[RenderableType]) -> None:
    """Write a page to stdout."""
    from gyrowheel.show.layout import show

    show(out(), parts)


def put_json(target: str, content: Any) -> None:
    """Write a result as JSON: to a file, atomically, or to stdout for ``-``."""
    from gyrowheel.show.files import json_text, write_text

    text = json_text(content)
    if target == "-":
        sys.stdout.write(text)
    else:
        write_text(Path(target), text)


def put_picture(path: Path | None, draw: Callable[[], Any], *, quiet: bool = False) -> None:
    """Write a picture if one was requested, and print its path unless stdout has JSON only."""
    if path is None:
        return
    from gyrowheel.show.figure import write_figure

    write_figure(draw(), path)
    if not quiet:
        out().print(f"\npicture: {path}", soft_wrap=True)


@contextlib.contextmanager
def editing(file: Path) -> Iterator[None]:
    """Lock a file against other processes from reading to writing; report if it has to wait."""
    from gyrowheel.show.files import changing

    with changing(file, waiting=functools.cache(lambda text: notes().print(text, soft_wrap=True))):
        yield


class Tour:
    """Shows the steps of a verb one after another; on stderr if ``--json -`` needs stdout."""

    def __init__(self, json: str | None) -> None:
        self._console = notes() if json == "-" else out()
        self._number = 0

    def step(self, title: str) -> None:
        """Begin the next step."""
        from rich.text import Text

        self._number += 1
        self._console.print(
            Text.assemble("\n", (f" {self._number} ", "bold reverse"), (f" {title}\n", "bold"))
        )

    def show(self, parts: Iterable[RenderableType]) -> None:
        """Show a result of the current step."""
        from gyrowheel.show.layout import show

        show(self._console, parts)

    def say(self, text: str, *, style: str = "") -> None:
        """Show a sentence of the current step."""
        from rich.text import Text

        self.show([Text(text, style=style)])


@contextlib.contextmanager
def working(first: str) -> Iterator[Say]:
    """Show the steps of a calculation on stderr: one changing line on a terminal, else a line for each."""
    console = notes()
    if not console.is_terminal:
        console.print(first, soft_wrap=True)
        yield lambda text: console.print(f"  {text}", soft_wrap=True)
        return
    with console.status(first) as status:
        yield lambda text: status.update(f"{first}: {text}")


@contextlib.contextmanager
def ending(early: type[KeyboardInterrupt]) -> Iterator[None]:
    """Let the first Ctrl-C raise `early`; the next one interrupts as usual."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGALRM)}
    if before[signal.SIGINT] is not signal.default_int_handler:  # ignored, or handled elsewhere
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if _compiles(frame):  # one that is interrupted cannot compile again in this process
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
            return
        raise early

    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _compiles(frame: FrameType | None) -> bool:
    """Whether a frame, or one that called it, is of the compiler."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith(_COMPILER):
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def advancing(title: str) -> Iterator[Fraction]:
    """Show progress on stderr: a bar on a terminal, else a line for each quarter."""
    console = notes()
    if not console.is_terminal:
        shown = 0

        def tell(part: float) -> None:
            nonlocal shown
            quarter = int(4.0 * part + 1e-9)
            if quarter > shown:
                shown = quarter
                console.print(f"{title}: {25 * quarter} %", soft_wrap=True)

        yield tell
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(title, total=1.0)
        yield lambda part: progress.update(task, completed=part)


def _refuse_empty(given: Sequence[str]) -> None:
    """Refuse an empty value, as of an unset shell variable; it would become the path of the working directory."""
    if given and given[0] == "run":  # its arguments are those of a node
        return
    for before, text in itertools.pairwise(["", *given]):
        option = before if not text else text.removesuffix("=")
        if (not text or text.endswith("=")) and re.fullmatch(r"--[a-z-]+|-[a-z]", option):
            raise InputError(f"{option}: the value is empty")


def _with_key(given: list[str]) -> list[str]:
    """Return the arguments with the name of a new key file after a ``--blind`` without one."""
    if not given or given[0] == "run" or _BLIND not in given:
        return given
    after = given.index(_BLIND) + 1
    if after < len(given) and not given[after].startswith("-"):
        return given
    file = next(name for name in _key_names() if not os.path.lexists(name))
    sys.stderr.write(f"{_BLIND}: the key goes into {file}\n")
    return [*given[:after], file, *given[after:]]


def _key_names() -> Iterator[str]:
    yield "key.json"
    yield from (f"key-{number}.json" for number in itertools.count(2))


def bad_input(text: str) -> int:
    """Report bad input in one line, and return its exit code."""
    _tell(f"error: {visible(' '.join(text.split()))}")
    return BAD_INPUT


def _usage(error: typer.TyperException) -> int:
    message = _value_message(error) or getattr(error, "format_message", lambda: str(error))()
    if type(error).__name__ == "NoArgsIsHelpError":  # has shown the help
        return BAD_INPUT
    context = getattr(error, "ctx", None)
    hint = f" (see: {context.command_path} --help)" if context is not None else ""
    return bad_input(message.rstrip(".") + hint)


def _value_message(error: typer.TyperException) -> str:
    """Return the message about a value out of its range; empty for any other error."""
    found = getattr(error.__cause__, "errors", None)
    parameter = getattr(error, "param", None)
    if found is None or parameter is None:
        return ""
    first = found()[0]
    limits = first.get("ctx", {})
    allowed = [f"{sign} {limits[name]:g}" for name, sign in _LIMITS.items() if name in limits]
    allowed += [words for name, words in _NUMBERS.items() if first["type"].startswith(name)]
    if not allowed:
        return ""
    return f"{parameter.get_error_hint()}: {first['input']} is not allowed; allowed: {', '.join(allowed)}"


class _Trimmed:
    """A file that strips trailing spaces: rich pads tables to the width of the terminal."""

    def __init__(self, *, stderr: bool) -> None:
        self._stderr = stderr

    @property
    def _stream(self) -> TextIO:
        """The current stream, which may be replaced at any time."""
        return sys.stderr if self._stderr else sys.stdout

    def write(self, text: str) -> int:
        self._stream.write(_TRAILING.sub("", text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _console(*, stderr: bool) -> Console:
    from gyrowheel.show.layout import TextConsole, readable

    # paths and texts of users may look like markup of rich
    trimmed = _Trimmed(stderr=stderr)
    file = None if trimmed.isatty() else cast(IO[str], trimmed)
    console = TextConsole(file=file, stderr=stderr, highlight=False, markup=False, emoji=False)
    console.width = readable(console.width)
    return console
