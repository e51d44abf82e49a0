"""Whole flights over links that lose bytes: packets cut anywhere, and pieces of frames."""

import math
from functools import cache

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.messages import position_target
from echowing.sim.flight import FlightResult, FormationFlight
from echowing.sim.ground import TELEMETRY
from echowing.sim.scenario import load_scenario
from echowing.sim.vehicle.autopilot import ORIGIN

from ..world import CLEARLY

pytestmark = pytest.mark.seconds(13)

FOLLOWER, SHORT = 2, "duration_s=40"
RADIOS = ("radio.leader", "radio.follower", "wire")


# What a frame changes it changes at once: fifteen seconds of them are enough.
HURLED = "duration_s=25"


def flight(seed: int, *changes: str) -> FormationFlight:
    return FormationFlight(load_scenario("echowing", [SHORT, *CLEARLY, *changes]), seed)


@cache
def calm() -> FlightResult:
    return flight(3, HURLED).run()


def broken_words(flown: FormationFlight) -> list[str]:
    """What the follower's script said of errors."""
    return [text for _, text in flown.followers[0].autopilot.texts if "error" in text.lower()]


def point(velocity_mps: float, *, whole: bool) -> bytes:
    """A guided point to the follower with this velocity, as a ground tool packs it."""
    sender = mavlink.MAVLink(None, 245, 190)
    frame = position_target(FOLLOWER, ORIGIN, 10.0, 0.0, 1.0, (velocity_mps, 0.0)).pack(sender)
    return bytes(frame) if whole else bytes(frame[:-1]) + bytes([frame[-1] ^ 0x55])


def hurl(flown: FormationFlight, frame: bytes, every_steps: int, from_s: float = 10.0) -> None:
    """Let the frame reach the follower's telemetry port, again and again."""
    steps = 0

    def after_step() -> None:
        nonlocal steps
        steps += 1
        if flown.t_s >= from_s and steps % every_steps == 0:
            flown.followers[0].autopilot.receive(TELEMETRY, frame + frame)

    result = flown.run(after_step=after_step)
    assert result.simulated_s == pytest.approx(25.0)


@pytest.mark.parametrize("velocity_mps", [1.5, math.nan])
def test_a_hundred_broken_frames_a_second_change_nothing_of_a_flight(velocity_mps: float) -> None:
    flown = flight(3, HURLED)
    hurl(flown, point(velocity_mps, whole=False), every_steps=1)

    mine, calm_one = flown.recorders[0].flight(), calm().flights[0]
    assert mine.follower_ned_m.tobytes() == calm_one.follower_ned_m.tobytes()
    assert broken_words(flown) == []


def test_a_whole_point_that_is_no_number_moves_nobody() -> None:
    """Its checksum is right: another tool sent it. Guided refuses it too, and brakes each time."""
    flown = flight(3, HURLED)
    hurl(flown, point(math.nan, whole=True), every_steps=25)

    assert flown.closest_m > 1.0
    assert broken_words(flown) == []


@pytest.mark.parametrize("generation", ["4.6", "4.8"])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_twentieth_of_the_packets_lost_is_borne(generation: str, seed: int) -> None:
    """On both radios and on the wire. The applet of 0.2.0 ended seven of twelve autopilots so."""
    lost = [f"{link}.byte_loss=0.05" for link in RADIOS]
    flown = flight(seed, f"follower.generation='{generation}'", *lost, "wire.flip=0.02")
    result = flown.run()

    assert broken_words(flown) == []
    assert flown.closest_m > 2.0
    error = abs(result.flights[0].separation_m[200:] - 3.0)
    # 0.14 m with all bytes. A leader that is 0.46 s late at 4 Hz is stale, and its follower held,
    # by two reports lost in a row.
    assert error.mean() < 0.8


def test_links_that_lose_a_third_of_their_packets_crash_nothing() -> None:
    lost = [f"{link}.byte_loss=0.33" for link in RADIOS]
    flown = flight(1, *lost, *(f"{link}.flip=0.05" for link in RADIOS))
    flown.run()

    assert broken_words(flown) == []
    assert flown.closest_m > 1.5


def test_lost_bytes_are_the_same_again_with_the_same_seed() -> None:
    changes = ("duration_s=15", *(f"{link}.byte_loss=0.1" for link in RADIOS))
    one, other = (flight(5, *changes).run().flights[0] for _ in range(2))

    assert one.follower_ned_m.tobytes() == other.follower_ned_m.tobytes()
