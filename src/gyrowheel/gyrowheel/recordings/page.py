"""Content of a recording, and the result of salvaging one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from rich.console import RenderableType

from gyrowheel.show.layout import Unbroken, figures_table, heading, indented, sentences, words_table
from gyrowheel_core.units import DEG, RPM
from gyrowheel_recording.bags.info import RecordingInfo
from gyrowheel_recording.bags.metadata import Publisher, surplus
from gyrowheel_recording.bags.reader import Integrity
from gyrowheel_recording.bags.salvage import Loss, Salvaged

_MOST_GAPS = 5
_MOST_LOSSES = 8


def info_page(found: RecordingInfo) -> Iterator[RenderableType]:
    """Yield the content of a recording."""
    yield Unbroken.assemble((found.path, "bold cyan"), f"  {found.size / 1e6:.1f} MB")
    facts = words_table("", "")
    facts.add_row("bench", found.bench or "not stated")
    facts.add_row("machine", found.machine or "not stated")
    if found.namespace:
        facts.add_row("namespace", found.namespace)
    facts.add_row(
        "duration", f"{found.duration:.2f} s, {found.integrity.samples} samples at {found.rate:.1f} Hz"
    )
    facts.add_row("samples", integrity_text(found.integrity))
    for topic, several in surplus(found.publishers).items():
        facts.add_row("publishers", f"{topic} had {len(several)}: {', '.join(map(_publisher, several))}")
    if found.unchecked:
        facts.add_row("checksums", _unchecked(found.unchecked))
    facts.add_row("spin rate", f"{_range(found.spin_rate, RPM)} rpm")
    facts.add_row("tilt", f"{_range(found.tilt, DEG)} deg")
    if found.holds:
        speeds = sorted({round(hold.spin_rate / RPM) for hold in found.holds})
        tilts = sorted({round(math.hypot(hold.tilt_x, hold.tilt_y) / DEG, 2) for hold in found.holds})
        facts.add_row("holds", f"{len(found.holds)} in {found.segments} segments")
        facts.add_row("  speeds", f"{', '.join(map(str, speeds))} rpm")
        facts.add_row("  tilts", f"{', '.join(f'{tilt:g}' for tilt in tilts)} deg")
    if found.rigs:
        facts.add_row("rig", ", ".join(found.rigs))
    for k, text in enumerate(found.assumed):
        facts.add_row("" if k else "assumed", text)
    yield indented(facts)
    yield from _topics(found.topics)


def salvage_page(found: Salvaged) -> Iterator[RenderableType]:
    """Yield the salvaged and the lost parts of a recording."""
    yield Unbroken.assemble((found.target, "bold cyan"), f"  from {found.source}")
    count = sum(found.messages.values())
    whole = "; nothing was missing" if found.complete else ""
    said = [f"{found.duration:.2f} s, {count} messages saved{whole}", *found.notes]
    said += [_loss(loss) for loss in found.losses[:_MOST_LOSSES]]
    if len(found.losses) > _MOST_LOSSES:
        said.append(f"and {len(found.losses) - _MOST_LOSSES} more places like these")
    if found.missing:
        said.append(f"{found.missing} messages that were recorded are missing")
    if found.lost_at_end:
        said.append(f"the last {_duration(found.lost_at_end)} are missing")
    if found.unchecked:
        said.append(_unchecked(found.unchecked))
    if found.integrity is not None:
        short = found.broken_off or found.lost_at_end
        said.append(
            f"samples: {integrity_text(found.integrity, 'complete up to where the file breaks off' if short else '')}"
        )
    yield from sentences(said)
    yield from _topics(found.messages)


def integrity_text(found: Integrity, whole: str = "") -> str:
    """Return the faults of the samples of a recording; `whole`, or ``complete``, without faults."""
    counts = {
        "missing": found.missing,
        "duplicate": found.duplicates,
        "out of order": found.out_of_order,
        "not finite or impossible": found.not_finite,
    }
    text = ", ".join(f"{n} {what}" for what, n in counts.items() if n) or whole or "complete"
    if found.stalls:
        stalls = ", ".join(f"{length:.3f} s at {at:.1f} s" for at, length in found.stalls[:_MOST_GAPS])
        more = f", and {len(found.stalls) - _MOST_GAPS} times more" if len(found.stalls) > _MOST_GAPS else ""
        text += f"; the bench stood still {stalls}{more}"
    if not found.gaps:
        return text
    gaps = ", ".join(f"{n} from {first}" for first, n in found.gaps[:_MOST_GAPS])
    more = f", and {len(found.gaps) - _MOST_GAPS} more gaps" if len(found.gaps) > _MOST_GAPS else ""
    return f"{text} (by sequence number: {gaps}{more})"


def _topics(counts: Mapping[str, int]) -> Iterator[RenderableType]:
    if not counts:
        return
    yield heading("Messages")
    table = figures_table("topic", "count")
    for name, count in counts.items():
        table.add_row(name, str(count))
    yield indented(table)


def _publisher(found: Publisher) -> str:
    count = "" if found.messages is None else f" {found.messages} messages"
    return f"{found.node or 'an unknown node'}{count} (GID {found.gid or 'unknown'})"


def _unchecked(count: int) -> str:
    return f"{count} messages have no checksum: damage within them would not show"


def _loss(loss: Loss) -> str:
    text = f"{loss.file}, byte {loss.byte}: {loss.reason}"
    if loss.messages is not None:
        text += f"; {loss.messages} messages"
    if loss.start is not None and loss.end is not None:
        text += f"{';' if loss.messages is None else ''} from {loss.start:.4f} to {loss.end:.4f} s"
    return text


def _duration(time: float) -> str:
    return f"{time * 1e3:.3g} ms" if time < 1.0 else f"{time:.4g} s"


def _range(extremes: tuple[float, float], unit: float) -> str:
    low, high = (f"{value / unit:.2f}".rstrip("0").rstrip(".") for value in extremes)
    return low if low == high else f"{low} .. {high}"
