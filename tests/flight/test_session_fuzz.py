"""The fuzz of the follow session: some of its flights, and that it finds what it looks for."""

import math
from functools import cache
from typing import Any

import pytest
from tests.flight.session_fuzz import FLIGHT_S, FindError, Fuzz
from tests.flight.yard import POINT, TICK_S

from echowing.flight.session import FollowSession

pytestmark = pytest.mark.seconds(5)

SEEDS = range(4)
TICKS = round(FLIGHT_S / TICK_S)


@cache
def flown(seed: int) -> Fuzz:
    return flown_again(seed)


def flown_again(seed: int) -> Fuzz:
    flight = Fuzz(seed)
    flight.fly()
    return flight


def test_some_flights_break_nothing_and_are_flights() -> None:
    # Two followers; they are engaged after a few seconds, and what is hostile holds them up.
    assert max(flown(seed).points for seed in SEEDS) > TICKS


def test_a_seed_is_the_same_flight_again() -> None:
    first, second = flown(3), flown_again(3)
    assert first.points == second.points
    assert first.session.events == second.session.events
    assert first.door.refused == second.door.refused


def fails_at(change: Any) -> Any:
    """A tick whose points are changed."""
    tick = FollowSession.tick

    def changed(session: FollowSession, now_s: float) -> list[tuple[int, Any]]:
        sent = tick(session, now_s)
        for _, message in sent:
            if message.get_type() == POINT:
                change(session, message)
        return sent

    return changed


def hang(session: FollowSession, message: Any) -> None:
    while True:
        pass


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda _, m: setattr(m, "vx", math.nan), "is not finite"),
        (lambda _, m: setattr(m, "lat_int", m.lat_int + 20_000), "is far from"),
        (lambda _, m: setattr(m, "alt", -300.0), "is no height"),
        (lambda _, m: setattr(m, "vy", 80.0), "is too fast"),
        (hang, "a tick of more than"),
    ],
)
def test_it_finds(change: Any, found: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FollowSession, "tick", fails_at(change))
    monkeypatch.setattr("tests.flight.session_fuzz.COUNTED_EVERY", 1)
    with pytest.raises(FindError, match=found):
        Fuzz(0).fly()
