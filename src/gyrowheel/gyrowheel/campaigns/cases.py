"""A campaign: its settings, and the list of its cases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import KINDS, Kind

CaseKind: TypeAlias = Kind | Literal["alike", "memory", "event"]
#: Relative frequency of each kind.
SHARES: dict[CaseKind, float] = dict([*KINDS.items(), ("alike", 0.5), ("memory", 0.3), ("event", 0.3)])
#: Largest fraction of lost samples: with more missing no window is complete.
MOST_LOST = 0.2


@dataclass(frozen=True)
class Campaign:
    """Settings of a campaign; together with its number they determine a case."""

    plan: str  # text of the plan that is diagnosed, and of the plan of the validation recording
    validation_plan: str
    bench: Bench = field(default_factory=Bench.load)  # the bench as its file describes it
    seed: int = 0  # seed; not negative
    kinds: tuple[CaseKind, ...] = tuple(KINDS)  # kinds of cases; see `SHARES` for their frequencies
    #: White noise and slow drifts of the readings, as multiples of the stated ones; every case varies about them.
    noise: float = 1.0
    drift: float = 1.0
    gains: float = (
        1.0  # spin gains, as multiples of those of the default controller; every case varies all gains
    )
    lost: float = 0.0  # fraction of lost samples, 0 .. 0.2
    reality: bool = (
        False  # whether the instruments are imperfect as well, and events may happen (kind ``event``)
    )

    def __post_init__(self) -> None:
        """Check every setting, and both plans against the bench."""
        if self.seed < 0:
            raise InputError(f"seed: {self.seed} is out of range; allowed: >= 0")
        known = tuple(kind for kind in SHARES if self.reality or kind != "event")
        if not self.kinds:
            raise InputError(f"kinds: none given; allowed: {', '.join(known)}")
        for kind in self.kinds:
            if kind not in known:
                hint = "" if self.reality or kind != "event" else "; events need --reality"
                raise InputError(f"kinds: '{kind}' is not known; allowed: {', '.join(known)}{hint}")
        if len(set(self.kinds)) < len(self.kinds):
            raise InputError(f"kinds: {', '.join(self.kinds)}: one is given twice")
        for name, low, high in (
            ("noise", 0.0, 100.0),
            ("drift", 0.0, 100.0),
            ("gains", 0.1, 4.0),
            ("lost", 0.0, MOST_LOST),
        ):
            value = getattr(self, name)
            if not math.isfinite(value) or not low <= value <= high:
                raise InputError(f"{name}: {value:g} is out of range; allowed: {low:g} .. {high:g}")
        for text in (self.plan, self.validation_plan):
            Plan.load(text).check(self.bench)


@dataclass(frozen=True)
class Case:
    """One case: everything that a worker needs to simulate, diagnose and judge it."""

    campaign: Campaign
    index: int  # from 0
    kind: CaseKind
    ordinal: int  # number of earlier cases of its kind: the effects take turns


def cases(campaign: Campaign, count: int, only: Sequence[int] = ()) -> list[Case]:
    """Return the cases of a campaign, or those of some numbers; a case does not depend on the number of cases."""
    if count < 1:
        raise InputError(f"cases: {count} is out of range; allowed: >= 1")
    for index in only:
        if not 0 <= index < count:
            raise InputError(f"only: {index} is out of range; allowed: 0 .. {count - 1}")
    total = sum(SHARES[kind] for kind in campaign.kinds)
    share = {kind: SHARES[kind] / total for kind in campaign.kinds}
    made = dict.fromkeys(campaign.kinds, 0)
    result = []
    for index in range(count):
        # the kind that is furthest behind its share is next
        kind = max(campaign.kinds, key=lambda k: share[k] * (index + 1) - made[k])
        result.append(Case(campaign, index, kind, made[kind]))
        made[kind] += 1
    return [case for case in result if not only or case.index in only]
