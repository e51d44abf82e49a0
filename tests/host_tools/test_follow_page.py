"""What `follow` hands to its page, and what it says of the formation's health: in flown time."""

from itertools import pairwise

import pytest

from echowing.tool.moment import Moment

from .test_follow_end import FOLLOWER, LEADER, NEVER_S, Flight, Screen

TAKEN_OVER_S = 10.0


class Watcher:
    """A page that remembers; at a moment the follower's pilot takes over, and stays behind."""

    said = "page: here"

    def __init__(self) -> None:
        self.moments: list[Moment] = []
        self.events: list[tuple[float, str]] = []
        self.flight: Flight | None = None

    def event(self, time_s: float, text: str) -> None:
        self.events.append((time_s, text))

    def show(self, moment: Moment) -> None:
        self.moments.append(moment)
        if self.flight is not None and moment.time_s > TAKEN_OVER_S:
            assert self.flight.autopilots[FOLLOWER].set_mode("LOITER")
            self.flight = None

    def lost(self) -> str | None:
        return "the page shows nothing any more" if len(self.moments) == 5 else None


@pytest.fixture(scope="module")
def flown() -> tuple[Watcher, Screen]:
    watcher, screen = Watcher(), Screen(NEVER_S, OSError())
    flight = watcher.flight = Flight(screen, page=watcher)
    assert flight.tool.run() == 0
    return watcher, screen


def test_a_page_gets_every_event_and_ten_moments_a_second(flown: tuple[Watcher, Screen]) -> None:
    watcher, screen = flown
    texts = [text for _, text in watcher.events]
    assert texts[0] == "page: here"
    assert texts == [text for text in screen.texts if "shows nothing any more" not in text]
    times_s = [moment.time_s for moment in watcher.moments]
    gaps_s = [b - a for a, b in pairwise(times_s)]
    # The clock goes on while the tool looks at it: a moment is late by what a turn takes of it.
    assert sum(gaps_s) / len(gaps_s) == pytest.approx(0.1, abs=0.03)


def test_a_page_that_is_lost_is_said_on_the_terminal(flown: tuple[Watcher, Screen]) -> None:
    assert "the page shows nothing any more" in flown[1].texts


def test_moments_carry_the_health_of_the_formation(flown: tuple[Watcher, Screen]) -> None:
    moments = flown[0].moments
    led = [one for one in moments if 6.0 < one.time_s < TAKEN_OVER_S]
    assert {one.health.near for one in led} == {((LEADER, FOLLOWER),)}
    assert moments[-1].health.near == ()
    assert moments[-1].health.lost == (FOLLOWER,)


def test_a_follower_that_is_left_behind_is_named(flown: tuple[Watcher, Screen]) -> None:
    """Its pilot has taken over, and the leader flies on at 2 m/s: 5.6 m away after 1.3 s."""
    watcher, screen = flown
    (lost_s,) = [time_s for time_s, text in watcher.events if "does not see anybody" in text]
    assert TAKEN_OVER_S + 3.0 < lost_s < TAKEN_OVER_S + 7.0
    assert any(text.startswith("follower 2 does not see anybody") for text in screen.texts)
