"""Files and folders: read with one-line errors, written atomically.

A new file or folder is written to a hidden temporary one in the same folder, which takes its name at the end. The
process that makes it locks it (`flock`), and the lock ends with the process: an unlocked one was left by a killed
process, and is removed when the same path is written again.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import math
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gyrowheel_core.errors import InputError, one_line, visible, with_article

#: More characters than any text that this project reads may have.
LONGEST_TEXT = 50_000_000
_TOKEN = 6  # bytes in the name of a temporary file
_LONGEST_NAME = 40  # characters of the target's name in it; a file system takes 255 bytes


def new_folder(parent: Path, name: str, first: int) -> Path:
    """Return ``parent/name-first``, or the next number without a folder."""
    number = first
    while (folder := parent / f"{name}-{number}").exists():
        number += 1
    return folder


def require_new(directory: Path, *, what: str = "recording") -> None:
    """Refuse a directory that is not empty.

    Parameters
    ----------
    directory : Path
        The directory.
    what : str
        What is to be created in it, for the message.

    Raises
    ------
    InputError
        If the path exists and is not an empty directory.
    """
    with disk_errors(directory):
        if directory.exists() and not (directory.is_dir() and not any(directory.iterdir())):
            raise InputError(f"{directory}: exists; {with_article(what)} needs a new directory")


@contextlib.contextmanager
def new_directory(directory: Path) -> Iterator[Path]:
    """Yield a temporary place for a new directory; it moves to `directory` when the block ends without an error.

    Raises
    ------
    InputError
        If the directory exists and is not empty, or its parent cannot be written to.
    """
    require_new(directory)
    with disk_errors(directory):
        target = _led_to(directory).absolute()
        if os.path.ismount(target):  # nothing can take its place
            raise InputError(f"{directory}: is the root of a file system; name a new folder in it")
        target.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        with disk_errors(target):
            workplace, _ = stack.enter_context(temporary_path(target, folder=True, mode=0o700))
        place = workplace / target.name
        try:
            yield place
        except InputError as error:  # it names the temporary place
            raise InputError(str(error).replace(str(place), str(directory))) from None
        with disk_errors(target):
            if target.exists():
                target.rmdir()
            os.replace(workplace / target.name, target)


def require_writable(file: Path) -> None:
    """Refuse a file that cannot be written, before the work that it is for begins.

    Raises
    ------
    InputError
        If it is not a file, or its folder cannot be written to.
    """
    with disk_errors(file):
        target = _led_to(file)
        _mode(target, file)
        folder = target.absolute().parent
        while not folder.exists():  # missing folders are made with the file
            folder = folder.parent
        with tempfile.NamedTemporaryFile(dir=folder, prefix=f".{file.name[:40]}."):
            pass


def is_file(path: Path) -> bool:
    """Whether there is a file.

    Raises
    ------
    InputError
        If the system cannot tell: the name is too long, or the folder may not be read.
    """
    with read_errors(path):
        return path.is_file()


def read_text(file: Path, *, errors: str = "strict") -> str:
    """Return the text of a file.

    Parameters
    ----------
    file : Path
        Path of the file.
    errors : str
        Handling of bytes that are not text, as for `bytes.decode`.

    Raises
    ------
    InputError
        If it cannot be read, is not text, has more than `LONGEST_TEXT` characters, or is a pipe, which would be waited
        for.
    """
    with read_errors(file):
        if file.is_fifo():
            raise InputError(f"{file}: cannot be read: it is a pipe, not a file")
        try:
            with file.open(encoding="utf-8", errors=errors) as stream:
                text = stream.read(LONGEST_TEXT + 1)
        except UnicodeDecodeError:
            raise InputError(f"{file}: not a text file") from None
    if len(text) > LONGEST_TEXT:
        raise InputError(f"{file}: is too long to be read; allowed: up to {LONGEST_TEXT} characters")
    return text


def read_beginning(file: Path, most: int) -> bytes:
    """Return up to `most` bytes of a file that nobody named; OSError for a link, a pipe, a device or a folder."""
    opened = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        if not stat.S_ISREG(os.fstat(opened).st_mode):
            raise OSError(errno.EINVAL, "is no file", str(file))
        return os.read(opened, most)
    finally:
        os.close(opened)


def read_json(file: Path) -> Any:
    """Return the content of a JSON file.

    Raises
    ------
    InputError
        If it cannot be read, or is not JSON.
    """
    text = read_text(file)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{file}: not valid JSON (line {error.lineno}, column {error.colno})") from None
    except (ValueError, RecursionError) as error:  # numbers with too many digits, brackets nested too deeply
        raise InputError(f"{file}: not valid JSON: {one_line(error)}") from None


@contextlib.contextmanager
def new_file(file: Path, *, private: bool = False) -> Iterator[Path]:
    """Yield a temporary file; it replaces `file` when the block ends without an error, and is removed otherwise.

    An existing file keeps its permissions and, as far as the user may change them, its owner and group; of a link, the
    target is replaced.

    Parameters
    ----------
    file : Path
        Path of the file; missing folders are made.
    private : bool
        Whether only its owner may read it. Other new files get the usual permissions.

    Yields
    ------
    Path
        An empty file in the same folder, to be overwritten.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with disk_errors(file):
        target = _led_to(file)
        target.parent.mkdir(parents=True, exist_ok=True)
        mode = _mode(target, file)
        with temporary_path(target, mode=0o600 if private or mode is not None else 0o666) as (place, opened):
            yield place
            if mode is not None and not private:
                _keep_owner(opened, target)
                os.fchmod(opened, mode)
            os.fsync(opened)  # else a power failure may leave an empty file under the name of the old one
            os.replace(place, target)


def _mode(target: Path, file: Path) -> int | None:
    """Return the permissions of a file to be replaced, None if it does not exist; refuse what may not be replaced.

    Replacing needs no permission for the file, but a read-only file is read-only for a reason.
    """
    try:
        found = target.lstat().st_mode
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(found) and not stat.S_ISLNK(found):
        raise InputError(f"{file}: cannot be written: it is not a file")
    if stat.S_ISREG(found) and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return stat.S_IMODE(found) & 0o777 if stat.S_ISREG(found) else None


def _keep_owner(opened: int, target: Path) -> None:
    """Set owner and group of a new file to those of the replaced one, as far as the user may."""
    before = target.stat()
    for owner, group in ((before.st_uid, -1), (-1, before.st_gid)):
        with contextlib.suppress(OSError):
            os.fchown(opened, owner, group)


def _led_to(file: Path) -> Path:
    """Return the target of a link; a link that another user may have placed is not followed, but replaced."""
    try:
        link = file.lstat()
    except FileNotFoundError:
        return file
    if not stat.S_ISLNK(link.st_mode):
        return file
    folder = file.parent.stat()
    shared = folder.st_mode & stat.S_ISVTX and folder.st_mode & stat.S_IWOTH  # as /tmp
    if shared and link.st_uid not in (os.geteuid(), folder.st_uid):
        return file
    return Path(os.path.realpath(file))


def write_bytes(file: Path, content: bytes, *, private: bool = False) -> None:
    """Write a file; after an error it is unchanged (see `new_file`).

    Raises
    ------
    InputError
        If it cannot be written.
    """
    with new_file(file, private=private) as place:
        place.write_bytes(content)


def write_text(file: Path, text: str, *, private: bool = False) -> None:
    """Write a text file; after an error it is unchanged (see `new_file`).

    Bytes of a file's name that are not text are written as escapes, which JSON restores.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    write_bytes(file, text.encode("utf-8", "backslashreplace"), private=private)


def json_text(content: Any) -> str:
    """Return content as the text of a JSON file; what is not finite becomes null."""
    # its escapes of hidden characters are those of JSON
    return visible(json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False)) + "\n"


def _plain(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    if isinstance(content, str | bool | int | None):
        return content
    if hasattr(content, "tolist"):  # arrays and scalars of numpy
        return _plain(content.tolist())
    number = float(content)
    return number if math.isfinite(number) else None


@contextlib.contextmanager
def read_errors(path: Path) -> Iterator[None]:
    """Turn an error of the disk, or of a name that no file can have, into an `InputError` that names `path`."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {_reason(error)}") from None
    except ValueError as error:  # a name with a zero byte, or of characters that no file name can have
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an error of the disk into an `InputError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {_reason(error)}") from None


def _reason(error: OSError) -> str:
    """Return the reason as the system gives it: libraries add where in their code it happened."""
    return os.strerror(error.errno) if error.errno else error.strerror or one_line(error)


@contextlib.contextmanager
def temporary_path(path: Path, *, folder: bool = False, mode: int = 0o666) -> Iterator[tuple[Path, int]]:
    """Make a hidden temporary file or folder in the folder of a path, for the time of the block.

    Parameters
    ----------
    path : Path
        The final path.
    folder : bool
        Whether it is a folder.
    mode : int
        Its permissions, less the process's mask.

    Yields
    ------
    place : Path
        The temporary file or folder; it is removed at the end of the block, if it is still there.
    descriptor : int
        Its descriptor, which holds the lock.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    _sweep(path)
    place, held = _made(path, folder, mode)
    try:
        yield place, held
    finally:
        _remove(place)
        os.close(held)


def _made(path: Path, folder: bool, mode: int) -> tuple[Path, int]:
    while True:
        place = path.with_name(f".{path.name[:_LONGEST_NAME]}.{secrets.token_hex(_TOKEN)}")
        if folder:
            os.mkdir(place, mode)
            held = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
        else:
            held = os.open(place, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode)
        # between making and locking it another process may have taken it for left behind
        if locked(held) is not False and place.exists():
            return place, held
        os.close(held)


def _sweep(path: Path) -> None:
    """Remove the temporary files that killed processes left for a path, as far as that is possible."""
    name = re.compile(rf"\.{re.escape(path.name[:_LONGEST_NAME])}\.[0-9a-f]{{{2 * _TOKEN}}}")
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(path.parent)):
            if not name.fullmatch(entry.name) or entry.is_symlink():
                continue
            with contextlib.suppress(OSError):
                opened = os.open(entry.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    if locked(opened):
                        _remove(Path(entry.path))
                finally:
                    os.close(opened)


def locked(opened: int) -> bool | None:
    """Lock a descriptor; False if another process holds the lock, None where the file system has no locks."""
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _remove(place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)


#: Environment variable with the limit of unpacked files [GB]: a small one can unpack to more than the memory.
LARGEST_VARIABLE = "GYROWHEEL_LARGEST_GB"
_USUAL = 4.0  # GB: five hours of the bench's samples
_GIGABYTE = 10**9


def largest_unpacked() -> int:
    """Return the largest size of an unpacked file [bytes].

    Raises
    ------
    InputError
        If the environment variable is not a number above zero.
    """
    given = os.environ.get(LARGEST_VARIABLE, "")
    try:
        limit = float(given) if given else _USUAL
    except ValueError:
        limit = math.nan
    if not 0.0 < limit < math.inf:
        raise InputError(
            f"{LARGEST_VARIABLE}: '{given}' is not allowed; allowed: a number of gigabytes above 0"
        )
    return int(limit * _GIGABYTE)


def require_room(size: float, what: str, whole: float = 0.0) -> None:
    """Refuse a size above `largest_unpacked`.

    The limit protects against small files that unpack to more than the memory. Unless the user states one, it is at
    least the size of the file.

    Parameters
    ----------
    size : float
        Needed memory [bytes].
    what : str
        Beginning of the message, with the file's name.
    whole : float
        Size of the file that it comes from [bytes].

    Raises
    ------
    InputError
        If it is too large; the message names the limit and the variable that raises it.
    """
    limit = float(largest_unpacked())
    if not os.environ.get(LARGEST_VARIABLE):
        limit = max(limit, whole)
    if size > limit:
        more = not math.isfinite(size)
        needed = f"more than {limit / _GIGABYTE:.3g} GB" if more else f"{size / _GIGABYTE:.3g} GB"
        raise InputError(
            f"{what} needs {needed} of memory; allowed: {limit / _GIGABYTE:.3g} GB "
            f"({LARGEST_VARIABLE} raises the limit)"
        )
