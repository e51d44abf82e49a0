"""Where the sonar is told to look: at the leader when the order arrives, and round it if unsure."""

import math
import re
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.axis import Axis, axis_of
from echowing.flight.cloud import SURE_AFTER_S
from echowing.flight.estimate import Estimate
from echowing.flight.follower import FollowerPlan
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.look import (
    GLANCE_S,
    NOSE_LOOKS_S,
    NOSE_RAD,
    REACH_RAD,
    ROUND_S,
    SURE_RAD,
    WIDEST_RAD,
    look_at,
)
from echowing.flight.session import FollowSession
from echowing.geo import GlobalPosition, displace
from echowing.mavlink.messages import EARTH_FRAME
from echowing.paths import repository_root
from echowing.sonar_file import shipped_sonar

LEADER, FOLLOWER, SONAR = 1, 2, 191
HERE = GlobalPosition(39.34, -86.03, 260.0)
TICK_S = 0.125
Mps = tuple[float, float]


def received(system_id: int, message: Any, component: int = 1) -> Any:
    """The message as received: packed by its sender, parsed by us."""
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
    return mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))


def position(now_s: float, at: GlobalPosition, mps: Mps) -> Any:
    lat, lon, alt = round(at.lat_deg * 1e7), round(at.lon_deg * 1e7), round(at.alt_m * 1e3)
    north, east = round(mps[0] * 100), round(mps[1] * 100)
    return mavlink.MAVLink_global_position_int_message(
        round(now_s * 1e3), lat, lon, alt, 10_000, north, east, 0, 0
    )


class Pair:
    """Leader and follower that report to a session, and the follower's sonar.

    to_it_m: from follower to leader, NED; mps: the leader's velocity.
    """

    def __init__(
        self,
        to_it_m: tuple[float, float, float] = (3.0, 0.0, 0.0),
        mps: Mps = (0.0, 0.0),
        others: int = 0,
    ) -> None:
        plans = [
            FollowerPlan(FOLLOWER + number, Slot(3.0 + 3.0 * number), 12.0, sonar=shipped_sonar())
            for number in range(1 + others)
        ]
        self.session = FollowSession(LEADER, plans, GuidanceSettings(), engaged=False)
        self.to_it_m, self.mps, self.now_s = to_it_m, mps, 0.0

    @property
    def follower(self) -> Any:
        return self.session.followers[FOLLOWER]

    def goes_on(
        self, seconds: float, range_m: float | None = 7.66, axis: Axis | None = None
    ) -> list[Any]:
        """The orders that the sonar gets meanwhile. range_m: what it reads, None: there is none."""
        orders = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            moved = self.mps[0] * self.now_s, self.mps[1] * self.now_s
            leader = displace(
                HERE, (self.to_it_m[0] + moved[0], self.to_it_m[1] + moved[1], self.to_it_m[2])
            )
            self._tell(LEADER, position(self.now_s, leader, self.mps))
            self._tell(FOLLOWER, position(self.now_s, HERE, (0.0, 0.0)))
            if range_m is not None:
                self._reads(range_m, axis or Axis(0.0))
            sent = [message for _, message in self.session.tick(self.now_s)]
            orders += [one for one in sent if one.get_type() == "GIMBAL_DEVICE_SET_ATTITUDE"]
        return orders

    def _reads(self, range_m: float, axis: Axis) -> None:
        stamp_ms = round(self.now_s * 1e3)
        range_m += 0.01 * (stamp_ms % 2)  # one that never changes is stuck
        reading = mavlink.MAVLink_named_value_float_message(stamp_ms, b"SNR_RAW", range_m)
        self._tell(FOLLOWER, reading, SONAR)
        status = mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, stamp_ms, EARTH_FRAME, list(axis.quaternion), 0.0, 0.0, 0.0, 0
        )
        self._tell(FOLLOWER, status, SONAR)

    def _tell(self, system_id: int, message: Any, component: int = 1) -> None:
        self.session.receive(received(system_id, message, component), self.now_s)


def axis_in(order: Any) -> Axis:
    axis = axis_of(order.q)
    assert axis is not None
    return axis


@pytest.mark.parametrize(
    ("to_it_m", "azimuth_deg", "elevation_deg"),
    [
        ((9.0, 0.0, 0.0), 0.0, 0.0),
        ((0.0, -9.0, 0.0), -90.0, 0.0),
        ((6.0, 6.0, -3.0), 45.0, 19.5),  # three metres higher, 8.5 m away
    ],
)
def test_it_looks_at_the_leader(
    to_it_m: tuple[float, float, float], azimuth_deg: float, elevation_deg: float
) -> None:
    order = Pair(to_it_m).goes_on(0.5)[-1]

    assert order.target_system == FOLLOWER
    assert order.target_component == SONAR
    assert order.flags == EARTH_FRAME
    assert math.degrees(axis_in(order).azimuth_rad) == pytest.approx(azimuth_deg, abs=3.0)
    assert math.degrees(axis_in(order).elevation_rad) == pytest.approx(elevation_deg, abs=3.0)


def test_a_leader_that_passes_turns_the_axis() -> None:
    """6 m/s across, 9 m away: 0.67 rad/s; in the same half second the order's axis turns by it."""
    orders = Pair(mps=(0.0, 6.0), to_it_m=(9.0, -3.0, 0.0)).goes_on(0.5)

    assert orders[-1].angular_velocity_z == pytest.approx(0.66, abs=0.05)
    turned_rad = axis_in(orders[-1]).azimuth_rad - axis_in(orders[0]).azimuth_rad
    assert turned_rad == pytest.approx(0.67 * 3 * TICK_S, abs=0.04)


def test_it_says_how_unsure_the_direction_is() -> None:
    """Receivers of 0.8 m or more at 3 m: some 33 degrees; heard from all sides, far less."""
    pair = Pair()
    unsure_rad = pair.goes_on(0.5)[-1].angular_velocity_x
    for _ in range(4):
        for aside_deg in (-18.0, 0.0, 18.0):
            pair.goes_on(0.75, 2.8, Axis(math.radians(aside_deg)))

    assert math.degrees(unsure_rad) == pytest.approx(33.0, abs=3.0)
    assert pair.goes_on(TICK_S, 2.8)[-1].angular_velocity_x < 0.5 * unsure_rad


def test_while_it_is_heard_and_unsure_the_axis_goes_round_it() -> None:
    """So that the beam's edge passes over it to every side, and not beyond half of the beam."""
    pair = Pair()
    pair.goes_on(2.0, 2.8)

    axes = [axis_in(order) for order in pair.goes_on(ROUND_S, 2.8)]

    middle_rad = sum(axis.azimuth_rad for axis in axes) / len(axes)
    aside = [axis.azimuth_rad - middle_rad for axis in axes]
    above = [axis.elevation_rad for axis in axes]
    assert 0.5 * SURE_RAD < max(aside) <= WIDEST_RAD + 0.05
    assert -0.5 * SURE_RAD > min(aside) >= -WIDEST_RAD - 0.05
    assert max(above) - min(above) > SURE_RAD


def test_one_that_was_just_found_is_looked_for_elsewhere_by_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Were it another one, the leader would be 3 m west of it: half of the time, for 5 s."""
    pair, shares = Pair(), []
    monkeypatch.setattr(Estimate, "_elsewhere", lambda *_: [(0.0, -3.0, 0.0)])
    pair.goes_on(0.5, 2.8)
    for _ in range(2):
        looks = pair.goes_on(4.0 * GLANCE_S, 2.8)
        aside = [one for one in looks if math.degrees(axis_in(one).azimuth_rad) < -30.0]
        shares.append(len(aside) / len(looks))
        pair.goes_on(SURE_AFTER_S, 2.8)
    assert shares == [pytest.approx(0.5, abs=0.1), 0.0]


def test_a_leader_that_is_not_heard_is_looked_for_by_the_gimbal() -> None:
    """No cone: the co-processor lays its figure 8 round the direction."""
    axes = [axis_in(order) for order in Pair((9.0, 0.0, 0.0)).goes_on(ROUND_S)]

    assert max(axis.azimuth_rad for axis in axes) - min(axis.azimuth_rad for axis in axes) < 0.2


def test_one_that_may_be_beside_the_gimbals_reach_is_looked_for_with_the_nose() -> None:
    """3 m away its direction is unsure by 33 degrees: it may be 99 degrees aside, by 3 sigma."""
    pair = Pair()
    axes = [axis_in(order) for order in pair.goes_on(NOSE_LOOKS_S)]
    aside = [axis.azimuth_rad for axis in axes]

    for side in (1.0, -1.0):
        assert math.radians(30.0) < max(side * one for one in aside) < NOSE_RAD + 0.1
    look = look_at(pair.session.known, pair.follower, pair.now_s)
    assert look is not None
    assert look.nose_rad == pytest.approx(aside[-1], abs=0.01)


def test_beside_other_followers_the_nose_stays_at_the_leader() -> None:
    """Looking aside it would hear one of them."""
    pair = Pair(others=1)
    axes = [axis_in(order).azimuth_rad for order in pair.goes_on(NOSE_LOOKS_S)]
    assert max(axes) - min(axes) < 0.2


def test_the_gimbal_reaches_as_far_as_the_co_processor_lets_it() -> None:
    table = repository_root() / "firmware/echowing/src/core/parameter_table.h"
    told = re.search(r'"PAN_REACH", (\d+),', table.read_text(encoding="utf-8"))
    assert told is not None
    assert math.degrees(REACH_RAD) == pytest.approx(float(told[1]))


def test_nobody_is_told_to_look_at_a_leader_that_is_stale() -> None:
    pair = Pair()
    assert pair.goes_on(0.5)

    pair.session.tick(pair.now_s + 0.9)
    sent = [one.get_type() for _, one in pair.session.tick(pair.now_s + 1.3)]
    assert "GIMBAL_DEVICE_SET_ATTITUDE" not in sent


def test_a_sonar_that_has_not_been_heard_of_gets_no_orders() -> None:
    assert Pair().goes_on(1.0, range_m=None) == []


def test_a_reading_counts_along_the_axis_that_came_with_it() -> None:
    """Heard 20 degrees to the right of where the receivers have it: that is where it is."""
    pair = Pair()
    for _ in range(6):
        pair.goes_on(0.5, 2.8, Axis(math.radians(35.0)))
        pair.goes_on(0.5, 7.66, Axis(math.radians(-10.0)))

    assert pair.follower.estimate.offset.east_m < -0.6


def test_without_its_axis_a_reading_of_a_gimbal_counts_for_nothing() -> None:
    pair, other = Pair(), Pair()
    for one in (pair, other):
        one.goes_on(2.0, 2.8)

    stamp_ms = round(pair.now_s * 1e3)
    for number in range(4):
        lost = mavlink.MAVLink_named_value_float_message(stamp_ms + number, b"SNR_RAW", 1.5)
        pair.session.receive(received(FOLLOWER, lost, SONAR), pair.now_s)
    for one in (pair, other):
        one.goes_on(0.5, range_m=None)

    assert pair.follower.estimate.offset.north_m == other.follower.estimate.offset.north_m
