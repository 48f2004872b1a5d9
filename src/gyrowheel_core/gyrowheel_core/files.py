"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gyrowheel_core.errors import InputError


def require_new(directory: Path) -> None:
    """Refuse a directory that already holds something.

    Raises
    ------
    InputError
        If the path exists and is no empty directory.
    """
    if directory.exists() and not (directory.is_dir() and not any(directory.iterdir())):
        raise InputError(f"{directory}: exists; a recording needs a new directory")


@contextlib.contextmanager
def new_directory(directory: Path) -> Iterator[Path]:
    """Give a place for a directory of the same name; it moves to where it belongs when the block has ended well.

    Raises
    ------
    InputError
        If the directory exists and is not empty, or its parent cannot be written to.
    """
    require_new(directory)
    target = directory.absolute()
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        workplace = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        yield workplace / target.name
        with disk_errors(target):
            if target.exists():
                target.rmdir()
            os.replace(workplace / target.name, target)
    finally:
        shutil.rmtree(workplace, ignore_errors=True)


def require_writable(file: Path) -> None:
    """Refuse a file that could not be written, before the work begins of which it takes the result.

    Raises
    ------
    InputError
        If it is no file, or the folder where it goes cannot be written to.
    """
    if file.exists() and not file.is_file():
        raise InputError(f"{file}: cannot be written: it is not a file")
    with disk_errors(file):
        folder = file.absolute().parent
        while not folder.exists():  # those that are missing are made with the file
            folder = folder.parent
        with tempfile.NamedTemporaryFile(dir=folder, prefix=f".{file.name[:40]}."):
            pass


def write_text(file: Path, text: str) -> None:
    """Write a text file that is whole or as it was before.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    with disk_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(text)
            # a temporary file is private to its owner, a result is a file like any other
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)
            os.replace(temporary, file)
        except BaseException:
            os.unlink(temporary)
            raise


def json_text(content: Any) -> str:
    """Return content as the text of a JSON file; what is not finite becomes null."""
    return json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


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
def disk_errors(path: Path) -> Iterator[None]:
    """Turn what the disk refuses into an `InputError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
