import math
from typing import Any

import pytest

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.follower import FollowerPlan
from echowing.flight.guidance import LeaderFix, Slot
from echowing.flight.known import Known
from echowing.flight.plan import planned
from echowing.flight.relay import RELAY_SETTINGS, RelayGuide, parse_ground
from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.sim.vehicle.copter import Copter
from echowing.sonar_file import shipped_sonar

from .relay_field import RELAY, REMOTE, RelayField

GROUND = GlobalPosition(39.34, -86.03, 250.0)


CLEAR_M = 15.0


def guided(guide: RelayGuide, remote_m: Ned, way_mps: Ned, here_m: Ned | None = None) -> Ned:
    """Where the relay is led, from the ground station."""
    remote = LeaderFix(10.0, displace(GROUND, remote_m), way_mps, 0.0)
    here = None if here_m is None else displace(GROUND, here_m)
    return ned_between(GROUND, guide.update(remote, 10.0, here).point)


def test_the_point_is_midway_to_where_the_remote_vehicle_is_now_beside_the_line() -> None:
    fix = LeaderFix(10.0, displace(GROUND, (200.0, 0.0, 0.0)), (4.0, 0.0, 0.0), 0.0)
    known = Known(REMOTE, [FollowerPlan(RELAY, Slot(0.0), sonar=shipped_sonar())], RELAY_SETTINGS)
    known.leader.fix = fix
    relay = known.followers[RELAY]
    relay.guide = RelayGuide(GROUND, CLEAR_M)
    relay.clock.answered(10.0, 0.0, 10.2)
    point = planned(known, relay, fix, 10.4)
    # Half a second until the point is there at 4 m/s is 2 m more to the north, of which the relay
    # goes half; to the right of somebody who comes back along the line is west.
    assert ned_between(GROUND, point.point)[:2] == pytest.approx((101.0, -CLEAR_M), abs=0.05)
    assert point.yaw_rad is None
    assert point.age_s == pytest.approx(0.4)


@pytest.mark.parametrize(("east_m", "side"), [(-3.0, -1.0), (3.0, 1.0), (0.2, -1.0)])
def test_it_takes_the_side_on_which_it_is_and_stays_there(east_m: float, side: float) -> None:
    guide = RelayGuide(GROUND, CLEAR_M)
    for here_m in ((100.0, east_m, 0.0), (100.0, 0.0, 0.0), (100.0, -2.0 * side, 0.0)):
        point_m = guided(guide, (200.0, 0.0, 0.0), (0.0, 0.0, 0.0), here_m)
        assert point_m[:2] == pytest.approx((100.0, side * CLEAR_M), abs=0.05)


def test_it_gives_way_to_one_that_flies_at_it_from_beside_the_line_while_it_is_to_come() -> None:
    # The relay's place is 15 m west of the line; the remote vehicle, 100 m north of it, flies at
    # that place: 101 m are 13 s at 8 m/s.
    place_m = guided(RelayGuide(GROUND, CLEAR_M), (200.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    way = (place_m[0] - 200.0, place_m[1], 0.0)
    far_m = math.hypot(*way)
    way_mps = (8.0 * way[0] / far_m, 8.0 * way[1] / far_m, 0.0)
    north_m, east_m, _ = guided(RelayGuide(GROUND, CLEAR_M), (200.0, 0.0, 0.0), way_mps)
    beside_m = ((north_m - 200.0) * way[1] - east_m * way[0]) / far_m
    assert abs(beside_m) == pytest.approx(CLEAR_M, abs=0.1)
    slow_m = guided(RelayGuide(GROUND, CLEAR_M), (200.0, 0.0, 0.0), (-3.0, -0.5, 0.0))
    assert slow_m[1] == pytest.approx(-CLEAR_M, abs=0.5)  # half a minute away


@pytest.mark.parametrize("here_m", [None, (0.0, 4.0, 0.0), (3.0, 0.0, 0.0)])
def test_over_the_ground_station_it_is_led_no_nearer(here_m: Ned | None) -> None:
    point_m = guided(RelayGuide(GROUND, CLEAR_M), (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), here_m)
    assert math.dist(point_m[:2], (3.0, 0.0)) == pytest.approx(CLEAR_M, abs=0.05)


# ---- flown ---------------------------------------------------------------------------------------

BACK_S = 12.0


def flown_back(speed_mps: float, *, heard: bool, **field: Any) -> RelayField:
    """A remote vehicle 60 m out that flies back to the ground station, at the relay's height."""

    def back(remote: Copter, now_s: float) -> None:
        if math.isclose(now_s, BACK_S):
            remote.set_speed_limit(speed_mps)
            remote.guided_position((0.0, 0.0, -30.0))

    flight = RelayField((60.0, 0.0), back, **field)
    flight.fly(BACK_S)
    flight.vehicles[REMOTE].silent = not heard
    flight.fly(60.0 / speed_mps + 6.0)
    assert flight.copters[REMOTE].north_m < 1.0
    return flight


@pytest.mark.parametrize("speed_mps", [5.0, 6.0, 7.0, 8.0])
@pytest.mark.parametrize("heard", [True, False])
def test_a_remote_vehicle_that_comes_back_passes_beside_it(speed_mps: float, heard: bool) -> None:
    """Also one that has lost its link, while the relay holds; on the line they met (0.03 m)."""
    # The receivers are off by 2.8 m towards the side that the relay takes.
    flight = flown_back(speed_mps, heard=heard, offset_m=(0.0, 2.8))
    assert flight.least_m > 10.0


@pytest.mark.parametrize("heard", [True, False])
def test_also_with_the_least_separation_it_is_never_under_a_metre(heard: bool) -> None:
    flight = flown_back(8.0, heard=heard, offset_m=(0.0, 2.8), min_separation_m=1.0)
    assert flight.least_m > 1.0


# ---- heights -------------------------------------------------------------------------------------


def heights(
    remote_m: float, relay_m: float, rtl: dict[str, float], home_m: float = 0.0
) -> list[str]:
    """What is said of the heights, and shown in the table."""
    flight = RelayField(
        *((60.0, 0.0), lambda *_: None),
        heights_m=(remote_m, relay_m),
        rtl=rtl,
        apart_m=5.0,
        home_m=home_m,
    )
    flight.fly(8.0)
    return [text for _, text in flight.session.events]


@pytest.mark.parametrize(
    ("remote_m", "relay_m", "rtl", "said"),
    [
        (20.0, 30.0, {"RTL_ALT": 3000.0}, "comes back at 30.0 m, 0.0 m below it"),
        (20.0, 30.0, {"RTL_ALT_M": 33.0}, "comes back at 33.0 m, 3.0 m above it"),
        (28.0, 30.0, {"RTL_ALT": 1500.0}, "comes back at 28.0 m, 2.0 m below it"),
        (20.0, 30.0, {}, "how high the leader comes back is not known"),
    ],
)
def test_heights_that_are_not_apart_are_warned_of(
    remote_m: float, relay_m: float, rtl: dict[str, float], said: str
) -> None:
    texts = [text for text in heights(remote_m, relay_m, rtl) if said in text]
    assert len(texts) == 1
    assert texts[0].startswith("follower 2: ")


def test_heights_that_are_apart_are_shown_and_not_warned_of() -> None:
    texts = heights(20.0, 30.0, {"RTL_ALT": 1500.0})
    assert not any("comes back" in text for text in texts)
    (begin,) = [number for number, text in enumerate(texts) if "before engaging" in text]
    (head,) = [number for number, text in enumerate(texts) if "RTL" in text.split()]
    assert begin <= head
    row = texts[head + 2]
    assert row.startswith("follower 2  ")
    assert "20.0 m" in row


def test_each_counts_its_height_from_its_own_home() -> None:
    # The relay is 36 m above the remote vehicle's home, and 30 m above its own on a hill of 6 m.
    rtl = {"RTL_ALT": 3000.0}
    assert not any("comes back" in text for text in heights(20.0, 36.0, rtl, home_m=6.0))
    texts = [text for text in heights(20.0, 31.0, rtl, home_m=6.0) if "comes back" in text]
    assert "comes back at 30.0 m, 1.0 m below it" in texts[0]


def test_one_that_climbs_to_the_relays_height_is_warned_of_then() -> None:
    def climb(remote: Copter, now_s: float) -> None:
        if math.isclose(now_s, 8.0):
            remote.guided_position((60.0, 0.0, -30.0))

    flight = RelayField(
        (60.0, 0.0), climb, heights_m=(20.0, 30.0), rtl={"RTL_ALT": 1500.0}, apart_m=5.0
    )
    flight.fly(8.0)
    assert flight.session.alerts == 0
    flight.fly(8.0)
    (text,) = [text for _, text in flight.session.events if "comes back" in text]
    assert "fly 5 m apart (--altitude)" in text
    assert flight.session.alerts == 1


def test_a_ground_station_is_a_latitude_and_a_longitude() -> None:
    assert parse_ground("39.34,-86.03") == GlobalPosition(39.34, -86.03, 0.0)
    for text in ("", "39.34", "north,west", "91,0", "0,181", "nan,0"):
        with pytest.raises(EchowingError, match="LAT,LON"):
            parse_ground(text)


def test_what_cannot_be_relayed_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    ends = ["relay", "--remote", "udpin:1", "--vehicle", "udpin:2", "--ground", "39,-86"]
    assert main([*ends, "--rate", "1"]) == 2
    assert "--rate 1: give 2 to 20" in capsys.readouterr().err
