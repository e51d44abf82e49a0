"""Points that carry a velocity: the applet moves them along the beam to the wanted distance."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from echowing.mavlink.messages import Manner

if TYPE_CHECKING:
    from tests.lua.conftest import MakeRig, Rig

HIGH, LOW = 3, 2
STEERED_M = 3.01  # a slot that has just opened, as for a leader that is not on a mission
HOLDING, BACKING_OFF, TOO_CLOSE = 7, 6, 3
SPD_MAX, SPD_LOST = 5.0, 3.0
FLOOR_MPS = pytest.approx(0.2)
LEADER_MPS = 2.0
NEARER_M = 0.2
BACK = 0.4  # of what is missing, so much is flown back
REST_MPS = 0.001  # a leader that rests: no velocity at all is a hold


@dataclass(frozen=True)
class Target:
    """A target with a velocity that the applet gave: from where the vehicle is."""

    north_m: float
    east_m: float
    down_m: float
    north_mps: float
    east_mps: float
    yaw_rad: float
    north_mps2: float
    east_mps2: float
    yaw_rps: float


def newest(r: Rig) -> Target:
    kind, values = r.vehicle.targets[-1]
    assert kind == "posvel"
    assert r.vehicle.position is not None
    north_m, east_m, down_m, north_mps, east_mps, _, yaw_rad, *rest = (
        float(v or 0.0) for v in values
    )
    here = r.vehicle.position
    return Target(
        north_m - here[0],
        east_m - here[1],
        down_m,
        north_mps,
        east_mps,
        yaw_rad,
        rest[0],
        rest[1],
        rest[3],
    )


def led(
    r: Rig, range_m: float, ahead_m: float, seconds: float = 2.0, *, mps: float = LEADER_MPS
) -> Rig:
    """Behind a leader of the same speed, with points that carry it, eight a second."""
    r.vehicle.velocity = (LEADER_MPS, 0.0, 0.0)
    r.range(range_m)
    r.raw_every_ms = 100
    stream(r, ahead_m, seconds, mps)
    return r


def stream(
    r: Rig,
    ahead_m: float,
    seconds: float,
    mps: float = LEADER_MPS,
    opens_m: float = 0.0,
    manner: Manner = Manner.HOLD,
) -> None:
    for _ in range(round(seconds / 0.12)):
        r.send_target(ahead_m, mps, opens_m=opens_m, manner=manner)
        r.run(0.12)


# ---- where the point goes -----


@pytest.mark.parametrize("range_m", [2.2, 2.9, 3.0, 3.4])
@pytest.mark.parametrize("ahead_m", [-0.3, 0.0, 0.3, 2.0])
def test_a_point_is_moved_to_the_wanted_distance(
    rig: MakeRig, range_m: float, ahead_m: float
) -> None:
    """Towards the leader by 0.2 m, the rest by 1 m/s for each metre; back by four tenths of it."""
    r = led(rig(), range_m, ahead_m)

    missing_m = range_m - 3.0
    wanted_m = min(NEARER_M, max(missing_m, BACK * missing_m))
    assert newest(r).north_m == pytest.approx(wanted_m, abs=0.03)
    catch_up_mps = max(0.0, missing_m - NEARER_M)
    assert newest(r).north_mps == pytest.approx(LEADER_MPS + catch_up_mps, abs=0.05)
    assert r.state == HOLDING
    assert r.speed_mps == SPD_MAX  # the limit caps the correction, and does not hinder it
    assert "holding the distance" in r.texts


def test_the_inset_of_the_sonar_counts_in_the_distance(rig: MakeRig) -> None:
    """2.9 m from the sonar's face are 3.1 m from centre to centre, 0.1 m too far."""
    r = led(rig(INSET=0.2), 2.9, 0.0)

    assert newest(r).north_m == pytest.approx(0.1, abs=0.03)
    assert r.vehicle.named["ECHO_RNG"][-1] == pytest.approx(3.1, abs=0.011)


def test_the_inset_is_added_once_to_averages_and_to_single_readings(rig: MakeRig) -> None:
    averages = rig(INSET=0.3).range(2.9)
    averages.vehicle.velocity = (LEADER_MPS, 0.0, 0.0)
    stream(averages, 0.0, 2.0)  # no single readings: the averages have to do
    singles = led(rig(INSET=0.3), 2.9, 0.0)

    assert newest(averages).north_m == pytest.approx(0.2, abs=0.03)
    assert newest(singles).north_m == pytest.approx(0.2, abs=0.03)


def test_the_detection_limit_stays_the_sonars(rig: MakeRig) -> None:
    """ECHO_DETECT 4.5 is a range of the sonar: 4.4 m is a target, though 4.6 m off."""
    assert led(rig(INSET=0.2), 4.4, 1.0).state == HOLDING
    assert led(rig(INSET=0.2), 4.5, 1.0).state != HOLDING


def test_little_further_towards_the_leader_than_the_point(rig: MakeRig) -> None:
    """The sonar wants it 1.4 m ahead, the ground tool 2 m back: 1 m from that, and no faster."""
    r = led(rig(), 4.4, -2.0, mps=1.0)

    assert newest(r).north_m == pytest.approx(-1.0, abs=0.13)  # the point moves on in 0.12 s
    assert newest(r).north_mps == pytest.approx(1.0, abs=0.01)


def test_five_metres_back_from_the_point_and_no_more(rig: MakeRig) -> None:
    """The sonar wants it 1.2 m back, the ground tool 5.3 m ahead."""
    r = led(rig(), 1.8, 5.3, mps=1.5)

    beyond_mps = newest(r).north_mps - 1.5  # what a target no nearer than NEARER_M leaves
    assert newest(r).north_m + beyond_mps == pytest.approx(0.3, abs=0.2)


def test_towards_the_leader_gently_so_that_it_stays_in_the_beam(rig: MakeRig) -> None:
    """A leader that flies off at 3.2 m/s: 0.2 m ahead at the most, and 3.5 m/s2 (20 degrees).

    The gap is flown by speed, up to 1 m/s more than the leader's.
    """
    r = led(rig(), 3.0, 0.0)
    speeds = [newest(r).north_mps]
    for number in range(12):
        r.range(3.0 + 0.12 * (number + 1))  # 1.2 m/s faster than the follower
        r.send_target(0.12 * number, 3.2)
        r.run(0.1)
        speeds.append(newest(r).north_mps)
        assert newest(r).north_m <= NEARER_M + 1e-3

    # An update every 50 ms, and the observer's speed between them.
    assert max(b - a for a, b in pairwise(speeds)) <= 0.35 + 0.05
    assert 3.2 < speeds[-1] <= 3.2 + 1.0


def test_away_from_the_leader_at_once(rig: MakeRig) -> None:
    r = led(rig(), 3.0, 0.0)
    before_mps = newest(r).north_mps
    for number in range(4):
        r.range(3.0 - 0.3 * (number + 1))  # 3 m/s towards it
        stream(r, 0.0, 0.12)

    assert newest(r).north_mps < before_mps - 1.5
    assert newest(r).north_m < -0.9 * BACK


def opened(r: Rig, opens_m: float, seconds: float = 2.0) -> Target:
    """3.2 m behind a leader of the same speed, the slot opened by the ground tool."""
    r.vehicle.velocity = (LEADER_MPS, 0.0, 0.0)
    r.range(3.2)
    r.raw_every_ms = 100
    for _ in range(round(seconds / 0.12)):
        r.send_target(0.0, LEADER_MPS, opens_m=opens_m)
        r.run(0.12)
    return newest(r)


def test_the_distance_that_the_ground_tool_has_opened_to_is_kept(rig: MakeRig) -> None:
    r = rig()
    assert opened(r, 3.6).north_m == pytest.approx(BACK * (3.2 - 3.6), abs=0.03)
    assert opened(r, 0.0).north_m == pytest.approx(3.2 - 3.0, abs=0.03)  # closed again


def test_who_flies_away_from_its_leader_stops_before_it_is_where_it_belongs(rig: MakeRig) -> None:
    """At 2.5 m and 1 m/s slower than the leader: 0.3 s later, when it leans, it is at 2.8 m."""
    r = led(rig(), 2.5, 0.0)
    slower_mps = LEADER_MPS - 1.0
    r.vehicle.velocity = (slower_mps, 0.0, 0.0)
    for number in range(60):
        r.range(1.9 + 0.01 * number)
        if number % 12 == 0:
            r.send_target(0.0, slower_mps)
        r.step()
    assert newest(r).north_m == pytest.approx(BACK * (2.5 + 0.3 - 3.0), abs=0.04)


def led_past_another(r: Rig, range_m: float, ahead_m: float, mps: float) -> Target:
    r.vehicle.velocity = (LEADER_MPS, 0.0, 0.0)
    r.range(range_m)
    r.raw_every_ms = 100
    for _ in range(16):
        r.send_target(ahead_m, mps, manner=Manner.MAKE_WAY)
        r.run(0.12)
    return newest(r)


@pytest.mark.parametrize(("ahead_m", "mps"), [(0.0, 1.0), (0.0, 2.2), (1.0, 1.5), (-2.0, 0.5)])
def test_a_point_past_another_vehicle_is_not_moved(
    rig: MakeRig, ahead_m: float, mps: float
) -> None:
    """At 2.2 m, 0.8 m too near: flown back it might meet the other, which it does not know."""
    target = led_past_another(rig(), 2.2, ahead_m, mps)
    assert target.north_mps == pytest.approx(mps, abs=0.01)
    assert target.north_m - target.north_mps * 0.07 == pytest.approx(ahead_m, abs=0.25)


def test_past_another_vehicle_it_flies_at_the_leader_no_faster_than_it_can_stop(
    rig: MakeRig,
) -> None:
    """At 1.8 m with CLOSE 1.2, DELAY 0.6, DECEL 2.5: 0.79 m/s faster than the leader, in all."""
    r = rig(CLOSE=1.2, DELAY=0.6, DECEL=2.5)
    target = led_past_another(r, 1.8, 1.0, 4.0)
    stoppable_mps = math.sqrt(1.5**2 + 5.0 * 0.6) - 1.5
    assert target.north_m + target.north_mps == pytest.approx(LEADER_MPS + stoppable_mps, abs=0.1)


@pytest.mark.parametrize("opens_m", [2.0, -4.0])
def test_the_ground_tool_opens_the_distance_and_never_closes_it(
    rig: MakeRig, opens_m: float
) -> None:
    assert opened(rig(), opens_m).north_m == pytest.approx(3.2 - 3.0, abs=0.03)


def test_it_opens_no_further_than_the_highest_echo_dist(rig: MakeRig) -> None:
    assert opened(rig(), 90.0).north_m == pytest.approx(BACK * (3.2 - 6.0), abs=0.03)


def test_along_the_beam_and_not_across_it(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.yaw = math.pi / 2  # facing east
    r.vehicle.velocity = (0.0, LEADER_MPS, 0.0)
    r.raw_every_ms = 100
    r.range(3.15)
    for _ in range(16):
        r.send_target(0.4, 0.3, aside_m=0.1, aside_mps=LEADER_MPS)
        r.run(0.12)

    target = newest(r)
    assert target.east_m == pytest.approx(0.15, abs=0.03)
    assert target.north_m == pytest.approx(0.4, abs=0.05)
    assert target.north_mps == pytest.approx(0.3, abs=0.01)
    assert target.east_mps == pytest.approx(LEADER_MPS, abs=0.05)


def test_the_point_moves_on_between_two_messages(rig: MakeRig) -> None:
    """Half a second after the newest point, at 2 m/s, its part across the beam is 1 m on."""
    r = led(rig(), 3.0, 0.0)
    r.send_target(0.0, LEADER_MPS, aside_mps=2.0)
    r.run(0.06)
    before_m = newest(r).east_m
    r.run(0.5)

    assert newest(r).east_m - before_m == pytest.approx(1.0, abs=0.11)


@pytest.mark.parametrize(("height_m", "up_m"), [(10.0, 10.0), (10.0, 14.0), (13.5, 12.0)])
def test_the_height_is_the_streams_above_home(rig: MakeRig, height_m: float, up_m: float) -> None:
    """The estimator's origin need not be at home's height: 10 m below the origin of zero here."""
    r = rig()
    r.vehicle.height_m = height_m
    led(r, 3.0, 0.0)
    for _ in range(4):
        r.send_target(0.0, LEADER_MPS, up_m=up_m)
        r.run(0.12)

    assert newest(r).down_m == pytest.approx(-10.0 - (up_m - height_m), abs=0.01)


@pytest.mark.parametrize("yaw_rad", [None, 0.4, -2.0])
def test_the_yaw_is_the_streams_or_the_one_it_has(rig: MakeRig, yaw_rad: float | None) -> None:
    r = led(rig(), 3.0, 0.0)
    r.send_target(0.0, LEADER_MPS, yaw_rad=yaw_rad)
    r.run(0.1)

    assert newest(r).yaw_rad == pytest.approx(yaw_rad or 0.0, abs=1e-4)
    assert newest(r).yaw_rps == 0.0


def test_the_nose_has_no_rate_of_its_own(rig: MakeRig) -> None:
    """After a leader that turns a corner, too: what it is late the gimbal makes up for."""
    r = led(rig(), 3.0, 0.0)
    for number in range(12):
        yaw_rad = 0.08 * number
        r.send_target(0.0, LEADER_MPS, yaw_rad=yaw_rad)
        r.run(0.12)
        assert newest(r).yaw_rad == pytest.approx(yaw_rad, abs=1e-4)
        assert newest(r).yaw_rps == 0.0


# ---- who is not held -----


def test_without_a_leader_the_points_are_flown_as_they_are(rig: MakeRig) -> None:
    r = led(rig(), 7.66, 0.0)
    r.range(7.66, HIGH)
    stream(r, 0.0, 2.0)

    assert r.vehicle.targets == []
    assert r.speed_mps == SPD_LOST
    assert r.state != HOLDING


@pytest.mark.parametrize("why", ["refused", "on the ground", "no position"])
def test_a_target_that_is_not_taken_is_no_holding(rig: MakeRig, why: str) -> None:
    """The guard keeps the distance then, as of points without a velocity."""
    r = rig()
    r.vehicle.takes_posvel = why != "refused"
    r.vehicle.is_flying = why != "on the ground"
    if why == "no position":
        r.vehicle.position = None
    led(r, 3.0, 0.0)
    assert r.state != HOLDING
    assert "holding the distance" not in r.texts

    r.range(0.9)
    stream(r, 0.0, 1.0)
    assert r.state == TOO_CLOSE
    assert r.speed_mps == FLOOR_MPS


def test_out_of_range_low_without_a_track_is_too_close(rig: MakeRig) -> None:
    r = rig().range(8.0, LOW)
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    for _ in range(8):
        r.send_target(0.0, 0.0)
        r.run(0.12)

    assert r.speed_mps == FLOOR_MPS


# ---- a leader that comes nearer, or is lost -----


class Loop:
    """A vehicle that goes where it is told (1 m/s a metre and the point's velocity, 2.5 m/s2)."""

    def __init__(self, r: Rig, leader_m: float) -> None:
        self.rig, self.leader_m, self.leader_mps = r, leader_m, REST_MPS
        self.place_m = self.mps = 0.0
        self.point_m = 0.0
        self.nearest_m = leader_m
        r.vehicle.velocity = (0.0, 0.0, 0.0)
        r.raw_every_ms = 100

    def fly(self, seconds: float, reading_m: float | None = None) -> None:
        """With the sonar's own reading, or one that is stuck."""
        r = self.rig
        for _ in range(round(seconds * 100)):
            r.range(self.leader_m - self.place_m if reading_m is None else reading_m)
            if r.vehicle.t_ms % 120 == 0:
                r.send_target(self.point_m - self.place_m, self.leader_mps)
            r.vehicle.position = (self.place_m, 0.0, -10.0)
            r.step()
            self._move(0.01)

    def _move(self, seconds: float) -> None:
        wanted_mps = 0.0
        if self.rig.vehicle.targets:
            _, values = self.rig.vehicle.targets[-1]
            wanted_mps = float(values[0] or 0.0) - self.place_m + float(values[3] or 0.0)
        change_mps = max(-2.5 * seconds, min(2.5 * seconds, wanted_mps - self.mps))
        self.mps += change_mps
        self.place_m += self.mps * seconds
        self.leader_m += self.leader_mps * seconds
        self.point_m += self.leader_mps * seconds
        self.rig.vehicle.velocity = (self.mps, 0.0, 0.0)
        self.nearest_m = min(self.nearest_m, self.leader_m - self.place_m)


def test_a_leader_that_flies_back_is_flown_back_from_at_once(rig: MakeRig) -> None:
    """2 m/s towards it from 3 m: it moves back 0.4 s later, and 2 m are left."""
    loop = Loop(rig(), 3.0)
    loop.fly(3.0)
    assert abs(loop.mps) < 0.05

    loop.leader_mps, loop.point_m = -2.0, 0.0
    loop.point_m = 1.5  # the ground tool does not know of it yet, and leads on
    loop.fly(0.4)
    assert newest(loop.rig).north_mps < -0.5
    loop.fly(0.2)
    assert loop.mps < -0.3
    loop.fly(2.0)

    assert loop.nearest_m > 1.8
    assert loop.mps == pytest.approx(-2.0, abs=0.5)


def braked(
    r: Rig,
    seconds: float,
    mps2: float,
    opens_m: float = 0.0,
    manner: Manner = Manner.HOLD,
    quickens_mps2: float = 0.0,
) -> Rig:
    """The leader 3 m ahead brakes for so long; the follower keeps its speed."""
    led(r, 3.0, 0.0)
    for number in range(round(seconds * 100)):
        time_s = 0.01 * (number + 1)
        r.range(3.0 - 0.5 * mps2 * time_s * time_s)
        if r.vehicle.t_ms % 120 == 0:
            r.send_target(
                0.0, LEADER_MPS, opens_m=opens_m, manner=manner, quickens_mps2=quickens_mps2
            )
        r.step()
    return r


@pytest.mark.parametrize("mps2", [-1.0, 1.0])
def test_what_the_leaders_reports_tell_of_its_acceleration_is_flown_ahead(
    rig: MakeRig, mps2: float
) -> None:
    """0.3 s of it, until the vehicle leans; not when no point has come for so long."""
    r = led(rig(), 3.0, 0.0)
    for _ in range(2):
        r.send_target(0.0, LEADER_MPS, quickens_mps2=mps2)
        r.run(0.12)
    assert newest(r).north_mps == pytest.approx(LEADER_MPS + 0.3 * mps2, abs=0.05)
    r.run(0.3)
    assert newest(r).north_mps == pytest.approx(LEADER_MPS, abs=0.05)


def test_a_leader_that_brakes_is_answered_once(rig: MakeRig) -> None:
    """By its reports or by the sonar, whichever tells of more: both at once would be too much."""
    by_sonar = newest(braked(rig(), 0.5, 2.5)).north_mps
    by_both = newest(braked(rig(), 0.5, 2.5, quickens_mps2=-1.0)).north_mps
    assert by_both == by_sonar


@pytest.mark.parametrize("mps2", [1.5, 2.5])
def test_a_leaders_braking_is_answered_with_as_much(rig: MakeRig, mps2: float) -> None:
    """0.5 s on, with the acceleration itself, and the velocity that the leader will then have.

    Guided answers a velocity alone a quarter of a second later (WP_ACC / PSC_JERK_NE), and leans
    0.3 s after that. The tracker is 0.3 s behind a change of the acceleration.
    """
    r = braked(rig(), 0.5, mps2)

    assert newest(r).north_mps2 == pytest.approx(-mps2, rel=0.35)
    assert newest(r).north_mps <= LEADER_MPS - 0.5 * mps2
    assert newest(r).east_mps2 == pytest.approx(0.0, abs=0.01)


def test_a_sonars_noise_is_no_braking(rig: MakeRig) -> None:
    """Steps of 1 cm, up and down at random: the point's velocity stays, without acceleration."""
    r = led(rig(), 3.0, 0.0)
    steps = random.Random(1)
    for _ in range(200):
        r.range(3.0 + 0.01 * steps.choice((-1, 0, 1)))
        stream(r, 0.0, 0.12)
        assert newest(r).north_mps2 == 0.0


@pytest.mark.parametrize("opens_m", [0.0, STEERED_M])
def test_a_leader_that_is_not_seen_brakes_no_further(rig: MakeRig, opens_m: float) -> None:
    """Three readings' time its braking counts, then no more: most likely it turns a corner."""
    r = braked(rig(), 0.4, 2.5, opens_m)
    track = r.host.local_value("track")
    seen_mps = track.leader_mps
    assert seen_mps == pytest.approx(LEADER_MPS - 0.4 * 2.5, abs=0.45)
    r.range(7.66, HIGH)
    stream(r, 0.0, 0.36, opens_m=opens_m)
    assert seen_mps - 0.5 < track.leader_mps <= seen_mps
    stream(r, 0.0, 0.6, opens_m=opens_m)
    assert seen_mps - 0.5 < track.leader_mps <= seen_mps
    assert newest(r).north_mps == pytest.approx(track.leader_mps, abs=0.05)
    assert newest(r).north_mps2 == 0.0


def test_backing_off_is_told(rig: MakeRig) -> None:
    r = led(rig(), 3.0, 0.0)
    for number in range(20):
        r.range(max(1.2, 3.0 - 0.15 * number))
        stream(r, 0.0, 0.12)

    assert "too close, backing off" in r.texts
    assert r.speed_mps == SPD_MAX


@pytest.mark.parametrize("stuck_m", [1.0, 4.4])
def test_a_stuck_sonar_does_not_run_away(rig: MakeRig, stuck_m: float) -> None:
    """Whatever it does the sonar says the same: after a second it flies the streamed points."""
    loop = Loop(rig(), 3.0)
    furthest_m = 0.0
    for _ in range(40):
        loop.fly(1.0, stuck_m)
        furthest_m = max(furthest_m, abs(loop.place_m))

    assert furthest_m < 2.5  # a second at up to 3 m/s
    assert abs(loop.mps) < 0.25  # an average that seems too near allows it 0.2 m/s


def test_the_leader_is_no_faster_than_the_points_and_one_metre_a_second(rig: MakeRig) -> None:
    """A stuck sonar shows a leader as fast as its own vehicle, however hard it brakes."""
    r = led(rig(), 3.0, 0.0)
    stream(r, 0.0, 0.5, 0.5)  # from 2 m/s; not yet long enough to be known as stuck

    assert r.state == HOLDING
    assert newest(r).north_mps == pytest.approx(1.5, abs=0.05)


def still_held_s(r: Rig, ahead_m: float) -> float:
    """For how long the distance is held after the sonar has lost the leader."""
    r.range(7.66, HIGH)
    start_ms = r.vehicle.t_ms
    while r.host.local_value("hold").active and r.vehicle.t_ms - start_ms < 6000:
        if r.vehicle.t_ms % 120 == 0:
            r.send_target(ahead_m, LEADER_MPS)
        r.step()
    return (r.vehicle.t_ms - start_ms) / 1000.0


@pytest.mark.parametrize("range_m", [2.2, 3.3])
@pytest.mark.parametrize("lost_s", [0.8, 1.3])
def test_a_leader_that_is_not_heard_is_carried_on_until_it_is_lost(
    rig: MakeRig, range_m: float, lost_s: float
) -> None:
    """For ECHO_LOST_T, near or not."""
    held_s = still_held_s(led(rig(LOST_T=lost_s), range_m, 0.0), 0.0)
    assert held_s == pytest.approx(lost_s, abs=0.15)


def test_blind_the_more_cautious_of_track_and_point_is_flown(rig: MakeRig) -> None:
    """Lost at 2.2 m: not to the 1 m ahead that is streamed, but back, as 0.8 m are missing.

    A point further back is flown as it is.
    """
    ahead = led(rig(), 2.2, 1.0)
    ahead.range(7.66, HIGH)
    stream(ahead, 1.0, 0.6)
    assert newest(ahead).north_m == pytest.approx(BACK * -0.8, abs=0.04)

    behind = led(rig(), 2.2, -2.0)
    behind.range(7.66, HIGH)
    stream(behind, -2.0, 0.6)
    assert newest(behind).north_m == pytest.approx(-2.0, abs=0.3)


def test_one_wild_reading_moves_nothing(rig: MakeRig) -> None:
    r = led(rig(), 3.0, 0.0)
    before = newest(r)
    r.raw_every_ms = None
    r.send_raw(1.1)
    r.run(0.1)

    assert newest(r).north_m == pytest.approx(before.north_m, abs=0.2)
    assert newest(r).north_mps == pytest.approx(before.north_mps, abs=0.05)


def test_three_echoes_alike_are_believed_however_short_a_leader_was_known(rig: MakeRig) -> None:
    """Four readings of it; each echo that does not agree takes one off."""
    r = led(rig(), 3.0, 0.0)
    r.raw_every_ms = None
    r.send_raw(7.66)
    r.run(3.0)  # forgotten
    for range_m in [2.8] * 3:
        r.send_raw(range_m)
        stream(r, 0.0, 0.1)
    assert r.host.local_value("track").readings == 4
    for range_m in [1.4, 1.38, 1.36]:
        r.send_raw(range_m)
        stream(r, 0.0, 0.1)

    assert r.host.local_value("track").readings == 3
    assert newest(r).north_m == pytest.approx(BACK * (1.36 + 0.2 - 3.0), abs=0.12)


@pytest.mark.parametrize(("echoes", "moves"), [(2, False), (3, True)])
def test_echoes_where_a_known_leader_cannot_be_move_nothing_until_the_third(
    rig: MakeRig, echoes: int, moves: bool
) -> None:
    """At 3 m and not seen for 0.2 s, then at 1.4 m: late echoes of something else, most likely.

    SITL 4.8 flew 5 m back from two of them. Three are an obstacle.
    """
    r = led(rig(), 3.0, 0.0)
    r.raw_every_ms = None
    for range_m in [7.66] * 2 + [1.4, 1.35, 1.3][:echoes]:
        r.send_raw(range_m)
        stream(r, 0.0, 0.1)

    # They come nearer by 0.5 m/s, and count as where they are once the vehicle leans.
    moved_m = BACK * (1.3 + 0.2 - 3.0 - 0.3 * 0.5)
    assert newest(r).north_m == pytest.approx(moved_m if moves else 0.0, abs=0.12)


NOTHING = 7.66  # what the sonar reads where it hears nothing


@pytest.mark.parametrize(
    "ranges_m",
    [
        [NOTHING, 3.45, NOTHING, 2.6, NOTHING, NOTHING],
        # A wild one, and then three that are not.
        [NOTHING, 3.2, 3.7, 3.2, 3.2],
        [NOTHING] * 3 + [3.25, 3.8, 3.25, 3.25],
        [NOTHING] * 5 + [2.8, 3.3, 2.8, 2.8],
    ],
)
def test_wild_readings_and_good_ones_are_no_leader_that_comes(
    rig: MakeRig, ranges_m: list[float]
) -> None:
    """Too far by 0.65 m, and 0.2 s later too near by 0.2 m: 4 m/s from one to the other.

    The first of a vee flew back at 4 m/s from a leader that flew on, and met the one behind it
    (vee, seed 1403, 0.42 m).
    """
    r = led(rig(), 3.0, 0.0)
    r.raw_every_ms = None
    for range_m in ranges_m:
        r.send_raw(range_m)
        stream(r, 0.0, 0.1)
        assert newest(r).north_m == pytest.approx(0.0, abs=0.3)
        assert newest(r).north_mps > 1.5


# ---- when points end, or change -----


def test_the_watchdog_holds_when_the_stream_ends(rig: MakeRig) -> None:
    r = led(rig(), 3.0, 0.0)
    r.run(1.3)

    assert (newest(r).north_mps, newest(r).east_mps) == (0.0, 0.0)
    # Where it comes to a stop from 2 m/s: 0.25 s of lean, then ECHO_DECEL 2.5 m/s2.
    assert r.target_ahead_m() == pytest.approx(2.0 * (0.25 + 2.0 / 5.0), abs=0.01)
    assert r.texts[-1] == "stream lost, holding here"
    targets = len(r.vehicle.targets)
    r.run(2.0)
    assert len(r.vehicle.targets) == targets  # told once, it stays


def test_it_stays_where_it_first_stands(rig: MakeRig) -> None:
    """With little speed allowed it stands before its place; given more, it would go on to it."""
    r = led(rig(), 3.0, 0.0)
    r.run(1.3)
    assert r.texts[-1] == "stream lost, holding here"
    assert r.target_ahead_m() > 1.0
    targets = len(r.vehicle.targets)
    r.vehicle.velocity = (0.2, 0.0, 0.0)
    r.run(1.0)

    assert r.target_ahead_m() < 0.1
    assert len(r.vehicle.targets) == targets + 1


def test_one_that_turns_round_does_not_stand(rig: MakeRig) -> None:
    """SITL: a stop placed anew as a follower leaned back at no speed made it swing by 1.4 m."""
    r = led(rig(), 3.0, 0.0)
    r.run(1.3)
    targets = len(r.vehicle.targets)
    for step in range(60):
        r.vehicle.velocity = (1.5 - 0.05 * step, 0.0, 0.0)  # through rest with 5 m/s2
        r.step()

    assert len(r.vehicle.targets) == targets


@pytest.mark.parametrize("mps2", [-1.0, 1.0])
def test_a_stop_counts_with_the_speed_that_it_will_have(rig: MakeRig, mps2: float) -> None:
    """0.25 s until it leans, in which the speed goes on changing; then ECHO_DECEL 2.5 m/s2."""
    r = led(rig(), 3.0, 0.0)
    mps = LEADER_MPS
    while r.texts[-1] != "stream lost, holding here":
        mps += mps2 * 0.01
        r.vehicle.velocity = (mps, 0.0, 0.0)
        r.step()

    then_mps = mps + mps2 * 0.25
    stopping_m = 0.25 * (mps + then_mps) / 2.0 + then_mps**2 / (2.0 * 2.5)
    assert r.target_ahead_m() == pytest.approx(stopping_m, abs=0.05)


def test_nor_does_a_retreat_of_before_keep_the_watchdog_from_it(rig: MakeRig) -> None:
    """The guard backed off from points without a velocity; then points with one were held."""
    r = rig()
    r.stream_every_ms, r.ahead_m, r.raw_every_ms = 120, 2.0, 50
    r.range(3.0).run(2.0)
    for number in range(120):
        r.range(max(1.2, 2.5 - number * 0.01))
        r.step()
    assert r.state == BACKING_OFF
    r.stream_every_ms = None
    r.vehicle.velocity = (LEADER_MPS, 0.0, 0.0)
    r.range(3.0)
    stream(r, 0.0, 3.0)
    assert r.state == HOLDING

    r.range(7.66, HIGH).run(3.0)
    assert "stream lost, holding here" in r.texts
    assert (newest(r).north_mps, newest(r).east_mps) == (0.0, 0.0)


def test_a_point_without_any_velocity_is_a_hold(rig: MakeRig) -> None:
    """The ground tool has stopped it: the sonar's error of 0.5 m moves it no more."""
    r = led(rig(), 2.5, 0.0)
    assert r.state == HOLDING
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    r.send_target(0.0, 0.0)
    r.run(0.1)
    targets = len(r.vehicle.targets)
    stream(r, 0.0, 1.2, mps=0.0)

    assert len(r.vehicle.targets) == targets
    assert r.state != HOLDING


# ---- in a line behind another follower -----


def in_line(r: Rig, range_m: float, mps: float = LEADER_MPS) -> Target:
    led(r, range_m, 0.0)
    stream(r, 0.0, 1.0, mps, manner=Manner.KEEP_PACE)
    return newest(r)


@pytest.mark.parametrize("range_m", [2.5, 2.9, 3.0, 3.2])
@pytest.mark.parametrize("mps", [1.5, 2.0])
def test_in_a_line_the_place_is_by_the_sonar_and_the_speed_by_the_point(
    rig: MakeRig, range_m: float, mps: float
) -> None:
    """The one ahead flies 2 m/s, whatever the point says. Back by four tenths of it."""
    target = in_line(rig(), range_m, mps)
    missing_m = range_m - 3.0
    assert target.north_m == pytest.approx(max(missing_m, BACK * missing_m), abs=0.03)
    assert target.north_mps == pytest.approx(mps, abs=0.03)


def test_in_a_line_the_braking_of_the_one_ahead_is_not_answered(rig: MakeRig) -> None:
    """It would be answered harder by each: all brake with the point, which is the leader's."""
    r = braked(rig(), 0.5, 2.5, manner=Manner.KEEP_PACE)
    assert newest(r).north_mps == pytest.approx(LEADER_MPS, abs=0.01)
    assert newest(r).north_mps2 == 0.0


def test_in_a_line_it_is_never_faster_than_it_can_still_stop(rig: MakeRig) -> None:
    """At 2 m the distance from which 2 m/s still end 1.5 m away is not there any more.

    Guided flies back by 1 m/s for each metre to the point, so the velocity may be as much more.
    """
    target = in_line(rig(), 2.0, LEADER_MPS + 2.0)
    stoppable_mps = math.sqrt((2.5 * 0.6) ** 2 + 2.0 * 2.5 * (2.0 - 1.5)) - 2.5 * 0.6
    assert target.north_m == pytest.approx(-0.4, abs=0.03)
    assert target.north_mps == pytest.approx(LEADER_MPS + stoppable_mps + 0.4, abs=0.1)


def test_in_a_line_one_that_is_not_seen_is_taken_to_keep_the_pace_of_all(rig: MakeRig) -> None:
    """It braked when it was seen last: carried on at that, it would seem a metre nearer."""
    r = braked(rig(), 0.4, 2.5, manner=Manner.KEEP_PACE)
    r.range(7.66, HIGH)
    stream(r, 0.0, 1.0, manner=Manner.KEEP_PACE)
    track = r.host.local_value("track")
    assert track.leader_mps == pytest.approx(LEADER_MPS, abs=0.05)
    assert track.range_m == pytest.approx(3.0 - 0.5 * 2.5 * 0.4**2, abs=0.25)


# ---- back from the one ahead, with others behind -----


def backs_off(r: Rig, range_m: float, leader_mps: float, manner: Manner, mps: float) -> float:
    """How fast Guided flies back for the leader at this distance and speed: place and velocity.

    The leader is further away by what it comes nearer in the 2 s in which it is heard.
    """
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    r.raw_every_ms = 100
    for number in range(200):
        r.range(range_m - leader_mps * (2.0 - 0.01 * number))
        if number % 12 == 0:
            r.send_target(0.0, mps, manner=manner)
        r.step()
    target = newest(r)
    return -(target.north_m + target.north_mps)


@pytest.mark.parametrize(("manner", "comes_mps"), [(Manner.HEAD, 0.8), (Manner.KEEP_PACE, 0.3)])
@pytest.mark.parametrize(("range_m", "missing_m"), [(2.0, 0.0), (1.2, 0.3)])
def test_with_others_behind_it_backs_off_hardly_faster_than_the_one_ahead_comes(
    rig: MakeRig, manner: Manner, comes_mps: float, range_m: float, missing_m: float
) -> None:
    """0.4 m/s faster, and 1 m/s for each metre that is missing to ECHO_CLOSE, 1.5 m.

    The head knows by its sonar how fast the leader comes, one in a line by its point.
    """
    back_mps = backs_off(rig(), range_m, -0.8, manner, -0.3)
    assert back_mps == pytest.approx(comes_mps + 0.4 + missing_m, abs=0.1)


@pytest.mark.parametrize("manner", [Manner.HEAD, Manner.KEEP_PACE])
def test_with_others_behind_the_place_is_moved_no_further_back_than_it_flies(
    rig: MakeRig, manner: Manner
) -> None:
    """1.4 m back and 1 m/s ahead is flown back first: in a line at 1 m/s, into the next one."""
    r = rig()
    backs_off(r, 1.6, -0.6, manner, 0.2)
    shares_m = BACK * (1.6 - 3.0 - 0.3 * 0.6)
    moved_m = shares_m if manner is Manner.HEAD else -0.4
    assert newest(r).north_m == pytest.approx(moved_m, abs=0.05)


@pytest.mark.parametrize(("manner", "flown_mps"), [(Manner.HEAD, 1.0), (Manner.KEEP_PACE, 2.0)])
def test_with_others_behind_it_goes_back_as_the_ground_tool_says(
    rig: MakeRig, manner: Manner, flown_mps: float
) -> None:
    """By the track the one ahead stands; a track that missed a leader who came met it (0.7 m).

    Ordered back by 2 m/s. The head hears its leader, so its point may err by 1 m/s.
    """
    assert backs_off(rig(), 2.5, 0.0, manner, -2.0) >= flown_mps


def test_with_nobody_behind_it_backs_off_to_the_wanted_distance(rig: MakeRig) -> None:
    """As fast as the leader comes, and by four tenths of what is missing once it leans."""
    missing_m = 1.0 + 0.3 * 0.8
    back_mps = backs_off(rig(), 2.0, -0.8, Manner.HOLD, -0.3)
    assert back_mps == pytest.approx(0.8 + BACK * missing_m, abs=0.05)


def test_in_a_line_the_one_ahead_comes_as_the_point_does_and_a_leader_as_it_is_heard(
    rig: MakeRig,
) -> None:
    """That one is led as well: what the track says beyond the point is its swing."""
    follower, leader = (
        backs_off(rig(), 1.0, -2.0, manner, 0.2) for manner in (Manner.KEEP_PACE, Manner.HEAD)
    )
    assert follower == pytest.approx(0.4 + 0.5, abs=0.1)
    assert leader == pytest.approx(2.0 + 0.4 + 0.5, abs=0.1)
