"""Who published the messages of a recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, info
from gyrowheel_recording.bags.live import LiveRecording, SampleCount
from gyrowheel_recording.bags.metadata import Division, Publisher, from_text, surplus, to_text

OWN, OTHER = ("aa", "/controller"), ("bb", "/other")


def counts(numbers: list[int], *known: tuple[str, str], later: int | None = None) -> dict[str, int | None]:
    """Return the messages of each publisher; the second one is known from message `later` on."""
    seen = list(known[:1] if later is not None else known)
    division = Division("/t", lambda: seen)
    for place, number in enumerate(numbers):
        if place == later:
            seen.append(known[1])
        division.add(number)
    return {publisher.node: publisher.messages for publisher in division.result()}


def test_one_publisher_has_all_messages_also_where_some_are_lost() -> None:
    assert counts([1, 2, 3], OWN) == {"/controller": 3}
    assert counts([5, 6, 9, 10], OWN) == {"/controller": 4}


def test_two_publishers_are_distinguished_by_their_message_numbers() -> None:
    assert counts([1, 2, 3, 1, 4, 2, 3, 5], OWN, OTHER, later=3) == {"/controller": 5, "/other": 3}
    # also one that had published before anyone here read it, and one that is lost in between
    assert counts([1, 2, 700, 3, 701, 4, 704, 5], OWN, OTHER, later=2) == {"/controller": 5, "/other": 3}


def test_silent_publisher_has_no_messages() -> None:
    assert counts([1, 2, 3, 4], OWN, OTHER, later=2) == {"/controller": 4, "/other": 0}


def test_ambiguous_publishers_have_no_counts() -> None:
    assert counts([1, 2, 9, 3, 10], OWN, OTHER) == {
        "/controller": None,
        "/other": None,
    }  # there from the beginning
    assert counts([1, 2, 9, 3, 10], OWN) == {"/controller": None, "": None}  # by one that nobody saw
    # both have come to 3
    assert counts([2, 1, 2, 3, 3], OWN, OTHER, later=1) == {"/controller": None, "/other": None}


@given(st.lists(st.booleans(), max_size=60), st.integers(0, 100))
def test_messages_in_any_order_are_divided_correctly_or_refused(others: list[bool], before: int) -> None:
    """However the messages of a publisher, and of one that comes later, are mixed."""
    order = [False] * (before + 1) + others
    numbers, following = [], [1, 1]
    for other in order:
        numbers.append(following[other])
        following[other] += 1
    if any(others):
        found = counts(numbers, OWN, OTHER, later=order.index(True))
        right: dict[str, int | None] = {"/controller": order.count(False), "/other": order.count(True)}
        met = any(order[:k].count(True) == order[:k].count(False) for k in range(1, len(order)))
        assert found == (right if not met else {"/controller": None, "/other": None})
    else:
        assert counts(numbers, OWN) == {"/controller": len(order)}


def test_samples_and_commands_that_come_more_than_once_are_counted(tmp_path) -> None:
    count = SampleCount()
    assert all(count.add(number) for number in (1, 2, 4, 4, 2, 3, 3))
    assert (count.samples, count.missing, count.surplus) == (4, 0, 3)

    session = LiveRecording(str(tmp_path / "run"), look=lambda topic: [OWN])
    for k in range(3):
        session.take(topics.MEASUREMENT, wire.MEASUREMENT.pack(k, k, *[0.0] * 11), k + 1)
        for voltage in (1.0, 2.0):
            session.take(topics.COMMAND, wire.COMMAND.pack(k, k, voltage, 0.0, 0.0), 2 * k + int(voltage))
    assert session.surplus_commands == 3
    assert session.report().endswith("3 samples, none missing, 3 surplus commands")
    session.close()
    found = info(tmp_path / "run").publishers
    assert found == (
        Publisher("/gyrowheel/measurement", *OWN, 3),
        Publisher("/gyrowheel/command", *OWN, 6),
    )
    assert surplus(found) == {}
    more = Publisher("/gyrowheel/command", *OTHER, 1)
    assert surplus((*found, more)) == {"/gyrowheel/command": [found[1], more]}
    several = [Publisher("/diagnostics", *OWN), Publisher("/diagnostics", *OTHER)]
    assert surplus(several) == {}  # every node publishes there


class Taking:
    """A recording of the samples of one publisher, beside which another one may come."""

    def __init__(self, folder: Path) -> None:
        self.had, self.there = [OWN], ["aa"]
        self.session = LiveRecording(
            str(folder), look=lambda topic: self.had, present=lambda topic: self.there
        )

    def take(self, number: int, sequence: int, value: float = 1.0) -> bool:
        data = wire.MEASUREMENT.pack(sequence * 500_000, sequence, *[value] * 11)
        return self.session.take(topics.MEASUREMENT, data, number)


@pytest.mark.parametrize("sent", [0, 3, 10**9])
def test_samples_of_another_publisher_are_counted_and_left_out(sent: int, tmp_path: Path) -> None:
    """Not even the number of a first sample ends the recording; nor do numbers far ahead cost what follows."""
    run = Taking(tmp_path / "run")
    assert all(run.take(k + 1, k) for k in range(10))
    run.had, run.there = [OWN, OTHER], ["aa", "bb"]
    assert all(run.take(k + 1, sent + k, 2.0) for k in range(2))
    assert all(run.take(k + 1, k) for k in (10, 11, 13, 14))  # of which one is lost
    count = run.session.count
    assert (count.samples, count.missing, count.surplus) == (14, 1, 2)
    run.session.close()
    found = Recording.open(tmp_path / "run")
    assert found.measurement["sequence"].tolist() == [*range(12), 13, 14]
    assert set(found.measurement["tilt_x"]) == {1.0}
    told = {publisher.node: publisher.messages for publisher in info(tmp_path / "run").publishers}
    assert told == {"/controller": 14, "/other": 0}


@pytest.mark.parametrize(
    ("number", "sequence", "had", "there"),
    [
        (5, 0, [OWN], ["aa"]),  # the same publisher begins again
        (5, 0, [OWN, OTHER], ["aa", "bb"]),
        (1, 0, [OWN, OTHER], ["bb"]),  # another one begins, and the first one has gone
        (1, 0, [OWN], ["aa"]),  # nobody knows of another one
        (3, 2, [OWN, OTHER], ["bb"]),  # its first samples were lost
        (9, 8, [OWN, OTHER], ["bb"]),  # and its numbers are as if they went on
    ],
)
def test_another_run_ends_the_recording(
    number: int, sequence: int, had: list[tuple[str, str]], there: list[str], tmp_path: Path
) -> None:
    run = Taking(tmp_path / "run")
    assert all(run.take(k + 1, k) for k in range(4))
    run.had, run.there = had, there
    assert not run.take(number, sequence)
    run.session.close()
    assert len(Recording.open(tmp_path / "run").measurement) == 4


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[1]", '[{"topic": "/t"}]', "[" * 100_000, "[" + "{}," * 2000 + "{}]"]
    + [
        to_text([Publisher(*entry)])
        for entry in (
            ("/t", "aa", "\x1b[2J", 1),
            ("/t", "aa", "n" * 1000, 1),
            ("/t", "aa", "/n", -1),
            ("/t", "aa", "/n", 0.5),
        )
    ],
)
def test_metadata_that_is_not_of_the_recorder_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^FILE: gyrowheel\.publishers: "):
        from_text(text, "FILE")
