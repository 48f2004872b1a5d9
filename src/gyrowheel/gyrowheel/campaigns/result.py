"""Outcome of a campaign of blind cases."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel.campaigns.judge import Judged
    from gyrowheel.campaigns.summary import Summary


@dataclass(frozen=True, repr=False)
class CampaignResult(Result):
    """Outcome of `gyrowheel.campaign`.

    Attributes
    ----------
    details : gyrowheel.campaigns.summary.Summary
        The statistics, and every case.
    title : str
        Plan, seed and variations.
    interrupted : bool
        Whether Ctrl-C ended it; the finished cases count.
    """

    details: Summary
    title: str
    interrupted: bool = False

    @property
    def cases(self) -> tuple[Judged, ...]:
        """The finished cases, by number."""
        return self.details.cases

    def __str__(self) -> str:
        """Return the title, and how many cases are right."""
        right = sum(case.right for case in self.cases)
        return f"{self.title}: {right} of {len(self.cases)} right"

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.campaigns.page import campaign_page

        return campaign_page(self.details, self.title)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel campaign --json``."""
        return self.details.to_json()

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the cases as columns, a row for each."""
        return {
            "case": [case.index for case in self.cases],
            "kind": [case.kind for case in self.cases],
            "hidden": [", ".join(case.truth) for case in self.cases],
            "named": [", ".join(case.named) for case in self.cases],
            "verdict": [case.verdict for case in self.cases],
            "outcome": [case.outcome for case in self.cases],
            "detectable": [case.detectable for case in self.cases],
        }
