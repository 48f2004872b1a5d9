"""A diagnosis as a document: HTML, Markdown or PDF."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gyrowheel.comparison.api import compare
from gyrowheel.diagnosis.api import diagnose
from gyrowheel.diagnosis.page import diagnosing, following
from gyrowheel.recordings.api import noted_machine
from gyrowheel.recordings.inputs import Recordings, Say, opened_apart
from gyrowheel.report.content import ReportContent
from gyrowheel.report.page import html_page, markdown_page
from gyrowheel.show.html import REPORT_TITLE
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import write_bytes, write_text

if TYPE_CHECKING:
    from gyrowheel.comparison.api import Comparison
    from gyrowheel.diagnosis.api import Diagnosis
    from gyrowheel.investigation.api import Investigation
    from gyrowheel.models.api import Model
    from gyrowheel.recordings.api import Recording

#: Formats of reports, and the endings of their files.
FORMATS = {"html": ".html", "md": ".md", "pdf": ".pdf"}
#: Papers of a PDF.
Paper = Literal["a4", "letter"]
PAPERS: tuple[Paper, ...] = ("a4", "letter")
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
_PATIENCE = 300.0  # s


class Report(ReportContent):
    """The result of a diagnosis in words, tables and pictures, with all that it rests on.

    The fields are those of `gyrowheel.report.content.ReportContent`.
    """

    @classmethod
    def of(
        cls,
        recordings: Recordings,
        model: Model,
        *,
        validate: Recordings = (),
        averages: bool = False,
        mixed: bool = False,
        progress: Say | None = None,
    ) -> Report:
        """Diagnose recordings and return the report.

        Parameters
        ----------
        recordings, model, validate, averages, mixed, progress
            As `gyrowheel.diagnose` takes them.

        Raises
        ------
        InputError
            If a recording cannot be read, is given twice, or is of another machine.
        """
        fitted, unused = opened_apart(recordings, validate)
        found = diagnose(fitted, model, validate=unused, averages=averages, mixed=mixed, progress=progress)
        paths, held = [r.path for r in fitted], [r.path for r in unused]
        file = Path(model.origin)
        return cls.around(
            found,
            model,
            fitted,
            unused,
            commands=[diagnosing(paths, file, held, averages=averages)],
            next_command=following(
                found, paths, held, file, model.bench_source, averages=averages, machine=noted_machine(fitted)
            ),
            mixed=mixed,
            progress=progress,
        )

    @classmethod
    def around(
        cls,
        diagnosis: Diagnosis,
        model: Model,
        fitted: Sequence[Recording],
        unused: Sequence[Recording] = (),
        *,
        better: Model | None = None,
        comparison: Comparison | None = None,
        commands: Sequence[str] = (),
        next_command: str | None = None,
        mixed: bool = False,
        progress: Say | None = None,
        investigation: Investigation | None = None,
    ) -> Report:
        """Return the report on an existing diagnosis.

        Parameters
        ----------
        diagnosis : Diagnosis
            The diagnosis, of `model` by `fitted`.
        model : Model
            The model that was diagnosed.
        fitted, unused : sequence of Recording
            Its recordings: those fitted, and those for validation.
        better : Model, optional
            The model with the findings.
        comparison : Comparison, optional
            Comparison of `model` with `fitted`; made here if not given.
        commands, next_command
            Commands that repeat the result, and the next one.
        mixed, progress
            As `gyrowheel.compare` takes them.
        investigation : Investigation, optional
            The investigation that ended with the diagnosis.
        """
        if comparison is None and not diagnosis.setup:
            # too little steady motion, which the diagnosis reports
            with contextlib.suppress(InputError):
                comparison = compare(fitted, model, mixed=mixed, progress=progress)
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        return cls(
            diagnosis,
            model,
            tuple(fitted),
            tuple(unused),
            better,
            comparison,
            tuple(commands),
            next_command,
            now,
            investigation,
            _account(),
        )

    def html(self) -> str:
        """Return the report as one page of HTML that needs no network; its one script draws signals."""
        return self._page

    @functools.cached_property
    def _page(self) -> str:
        # its pictures take seconds
        return html_page(self)

    def markdown(self) -> str:
        """Return the report as Markdown, without pictures."""
        return markdown_page(self)

    def pdf(self, paper: Paper = "a4") -> bytes:
        """Return `html` as PDF on A4 or letter paper, printed by Chromium; InputError if none is installed."""
        return pdf(self.html(), paper)

    def save(self, path: str | Path, *, paper: Paper = "a4") -> None:
        """Write the report, atomically: a failure leaves the old file.

        Parameters
        ----------
        path : str or Path
            The file; its ending gives the format: ``.html``, ``.md``, or ``.pdf`` where Chromium is installed.
        paper : str
            Paper of a PDF: ``a4`` or ``letter``.

        Raises
        ------
        InputError
            If the ending is another one, Chromium is missing, or the file cannot be written.
        """
        file = Path(path)
        if file.suffix not in FORMATS.values():
            raise InputError(
                f"{path}: the ending '{file.suffix}' is not known; allowed: {', '.join(FORMATS.values())}"
            )
        if file.suffix == FORMATS["pdf"]:
            write_bytes(file, self.pdf(paper))
        else:
            write_text(file, self.html() if file.suffix == FORMATS["html"] else self.markdown())

    def __repr__(self) -> str:
        """Return the result in a sentence."""
        return f"<Report: {self.title}>"


def _account() -> str:
    """Return the name of the account that runs this; empty where the system has none for it."""
    import getpass

    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):
        return ""


def browser() -> str | None:
    """Return the path of Chromium; None if it is not installed."""
    return next((found for found in map(shutil.which, _BROWSERS) if found), None)


def pdf(page: str, paper: Paper = "a4") -> bytes:
    """Return a self-contained page as PDF, printed without network by an installed Chromium, its parts opened."""
    if paper not in PAPERS:
        raise InputError(f"paper: {paper!r} is not allowed; allowed: {', '.join(PAPERS)}")
    program = browser()
    if program is None:
        raise InputError(
            "PDF: needs Chromium, which is not installed; write .html, which every browser prints"
        )
    page = page.replace("<details>", "<details open>")
    page = page.replace("</head>", f"<style>@page {{ size: {paper}; }}</style>\n</head>", 1)
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
