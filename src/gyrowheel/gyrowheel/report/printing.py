"""HTML pages as PDF, printed by an installed Chromium."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from gyrowheel.show.html import REPORT_TITLE
from gyrowheel_core.errors import InputError

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
_PATIENCE = 300.0  # s


def browser() -> str | None:
    """Return the path of Chromium; None if it is not installed."""
    return next((found for found in map(shutil.which, _BROWSERS) if found), None)


def pdf(page: str) -> bytes:
    """Return a self-contained page as PDF.

    Parameters
    ----------
    page : str
        The page; it is printed without network.

    Raises
    ------
    InputError
        If no Chromium is installed, or it prints nothing.
    """
    program = browser()
    if program is None:
        raise InputError(
            "PDF: needs Chromium, which is not installed; write .html, which every browser prints"
        )
    titled = re.sub(r"<title>.*?</title>", f"<title>{REPORT_TITLE}</title>", page, count=1, flags=re.DOTALL)
    with tempfile.TemporaryDirectory(prefix="gyrowheel-") as scratch:
        place = Path(scratch)
        (place / "report.html").write_text(titled, encoding="utf-8")
        command = [
            program,
            "--headless",
            "--disable-gpu",
            "--proxy-server=127.0.0.1:9",  # no request of the page is answered
            f"--user-data-dir={place / 'profile'}",
            "--no-pdf-header-footer",
            f"--print-to-pdf={place / 'report.pdf'}",
            (place / "report.html").as_uri(),
        ]
        if os.geteuid() == 0:
            # without it Chromium refuses to run as root; the page runs no script but ours
            command.insert(1, "--no-sandbox")
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"PDF: {program} does not print: {error}") from None
        printed = place / "report.pdf"
        if not printed.is_file():
            last = done.stderr.strip().rpartition("\n")[2][:200]
            raise InputError(f"PDF: {program} ended with {done.returncode} and printed nothing: {last}")
        return printed.read_bytes()
