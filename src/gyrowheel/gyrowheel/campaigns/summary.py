"""Statistics of the judged cases of a campaign."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from gyrowheel.campaigns.judge import EventJudged, InstrumentJudged, Interval, Judged

#: Confidence levels at which the intervals are checked.
LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
#: Noise floors up to which an error on a validation recording counts as noise ...
WITHIN_FLOOR = 1.2
#: ... and with a formula that was proposed for an unknown effect.
WITHIN_FORMULA = 1.5


@dataclass(frozen=True)
class Rate:
    """A relative frequency with its 95 % interval (Clopper and Pearson, valid for any number of cases)."""

    count: int
    n: int

    @property
    def part(self) -> float:
        """The fraction; NaN if there are no cases."""
        return self.count / self.n if self.n else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the true fraction, with 95 % confidence."""
        if not self.n:
            return 0.0, 1.0
        from scipy.stats import binomtest

        found = binomtest(self.count, self.n).proportion_ci(method="exact")
        return float(found.low), float(found.high)


@dataclass(frozen=True)
class Summary:
    """The statistics of a campaign.

    Attributes
    ----------
    seed : int
        Seed of the campaign.
    asked : int
        Number of cases requested.
    cases : tuple of Judged
        The finished cases, by number.
    title : str
        Plan, seed and variations.
    interrupted : bool
        Whether Ctrl-C ended it; the finished cases count.
    """

    seed: int
    asked: int
    cases: tuple[Judged, ...]
    title: str = ""
    interrupted: bool = False

    @classmethod
    def counted(
        cls, seed: int, asked: int, cases: Iterable[Judged], title: str = "", *, interrupted: bool = False
    ) -> Summary:
        """Return the summary of finished cases, in any order."""
        return cls(seed, asked, tuple(sorted(cases, key=lambda c: c.index)), title, interrupted)

    def of_kind(self, kind: str) -> list[Judged]:
        """Return the cases of a kind."""
        return [c for c in self.cases if c.kind == kind]

    @property
    def false_alarms(self) -> Rate:
        """Cases without a hidden effect in which one was found.

        An effect that ties with a wrong instrument is no false alarm.
        """
        none = self.of_kind("none")
        fine = {"exact", "missed", "tied", "tied_without_test"}
        return Rate(sum(c.outcome not in fine for c in none), len(none))

    @property
    def instruments(self) -> list[InstrumentJudged]:
        """All wrong instruments."""
        return [i for c in self.cases for i in c.instruments]

    @property
    def events(self) -> list[EventJudged]:
        """All hidden events."""
        return [c.event for c in self.cases if c.event is not None]

    @property
    def tally(self) -> dict[str, int]:
        """Numbers of the answers that are right, of those that miss what is too small, and of those that are wrong."""
        small = sum(c.too_small for c in self.cases)
        right = sum(c.right for c in self.cases) - small
        return {"right": right, "too_small": small, "wrong": len(self.cases) - right - small}

    def detectable(self, kind: str) -> list[Judged]:
        """Return the detectable cases of a kind."""
        return [c for c in self.of_kind(kind) if c.detectable]

    def outcomes(self, cases: Iterable[Judged]) -> Counter[str]:
        """Count the outcomes of cases."""
        return Counter(c.outcome for c in cases)

    @property
    def intervals(self) -> list[Interval]:
        """All coefficients of rightly named effects."""
        return [i for c in self.cases for i in c.intervals]

    @property
    def parameters(self) -> list[Interval]:
        """All fitted bench parameters of the exactly named cases."""
        return [i for c in self.cases for i in c.parameters]

    @property
    def validated(self) -> Rate:
        """Exactly named cases whose error on the validation recording falls to the noise."""
        errors = [
            c.validation for c in self.cases if c.truth and c.outcome == "exact" and c.validation is not None
        ]
        return Rate(sum(e <= WITHIN_FLOOR for e in errors), len(errors))

    @property
    def formulas_validated(self) -> Rate:
        """Cases rightly called unknown, whose error falls to the noise with the proposed formula."""
        errors = [
            c.validation
            for c in self.of_kind("outside")
            if c.outcome == "unknown" and c.validation is not None
        ]
        return Rate(sum(e <= WITHIN_FORMULA for e in errors), len(errors))

    @property
    def median_seconds(self) -> float:
        """Median duration of a diagnosis [s]; NaN without one."""
        seconds = [c.seconds for c in self.cases if not math.isnan(c.seconds)]
        return statistics.median(seconds) if seconds else math.nan

    @property
    def confusion(self) -> dict[str, dict[str, int]]:
        """{truth: {answer: number of cases}}."""
        table: dict[str, Counter[str]] = {}
        for case in self.cases:
            table.setdefault(case.truth_label, Counter())[case.named_label] += 1
        return {truth: dict(counts.most_common()) for truth, counts in sorted(table.items())}

    def to_json(self) -> dict[str, Any]:
        """Return the statistics as a JSON object."""
        outside = self.of_kind("outside")
        how = self.outcomes(outside)
        return {
            "schema": 1,
            "seed": self.seed,
            "cases": len(self.cases),
            "none": {"n": self.false_alarms.n, "false_alarms": self.false_alarms.count},
            "single": self._found("single"),
            "pair": self._found("pair"),
            "outside": {
                "n": len(outside),
                "unknown": how["unknown"],
                "named_right": how["named_right"],
                "absorbed": how["misnamed"],
                "missed": how["missed"],
                "formula_validated": self.formulas_validated.count,
            },
            **{kind: self._found(kind) for kind in ("alike", "memory") if self.of_kind(kind)},
            **self._reality(),
            "coverage95": covered(self.intervals, 0.95).part,
            "validated": {"n": self.validated.n, "within_1p2_floor": self.validated.count},
            "median_seconds": self.median_seconds,
            "confusion": self.confusion,
            # beyond the contract
            "tally": self.tally,
            "asked": self.asked,
            "false_alarm_interval95": list(self.false_alarms.interval),
            "coverage": {
                name: {"n": len(given), **{f"{level:g}": covered(given, level).part for level in LEVELS}}
                for name, given in (("coefficients", self.intervals), ("bench", self.parameters))
            },
            "failed": [c.index for c in self.cases if c.outcome == "failed"],
            "not_right": [c.index for c in self.cases if not c.right],
        }

    def _reality(self) -> dict[str, Any]:
        """Return the counts of instruments and events, if there were any.

        Named, tied and wrong add up to the detectable instruments, dated and missed to the detectable events.
        """
        result: dict[str, Any] = {}
        wrong = [name for c in self.cases for name in c.instruments_wrong]
        if self.instruments or wrong:
            seen = [i for i in self.instruments if i.detectable]
            how = Counter(i.found for i in seen)
            result["instrument"] = {
                "n": len(self.instruments),
                "detectable": len(seen),
                "named": how["named"],
                "tied": how["tied"],
                "wrong": how["missed"],
                "named_falsely": len(wrong),
            }
        if self.events:
            visible = [e for e in self.events if e.detectable]
            dated = sum(e.dated for e in visible)
            result["event"] = {
                "n": len(self.events),
                "detectable": len(visible),
                "dated": dated,
                "missed": len(visible) - dated,
            }
        return result

    def _found(self, kind: str) -> dict[str, Any]:
        """Return the counts of a kind; exact, tied and wrong add up to the detectable cases."""
        seen = self.detectable(kind)
        how = self.outcomes(seen)
        below = self.outcomes(c for c in self.of_kind(kind) if not c.detectable)
        return {
            "n": len(self.of_kind(kind)),
            "detectable": len(seen),
            "exact": how["exact"],
            "tied": how["tied"],
            "wrong": len(seen) - how["exact"] - how["tied"],
            "wrong_how": {k: v for k, v in sorted(how.items()) if k not in ("exact", "tied")},
            "below": dict(sorted(below.items())),
        }


def covered(intervals: Sequence[Interval], level: float) -> Rate:
    """Return the fraction of intervals of a level that contain the truth."""
    width = statistics.NormalDist().inv_cdf(0.5 + 0.5 * level)
    return Rate(sum(abs(i.pull) <= width for i in intervals), len(intervals))
