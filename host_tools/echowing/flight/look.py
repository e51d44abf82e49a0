"""Where a sonar is to look: at its leader, and round it while its direction is unsure. Pure.

A leader that is always heard may be anywhere in the beam; the beam's edge passing over it shows
where. So the axis goes round the expected direction on a cone, as wide as the direction is unsure
across and in height. A leader that is not heard the co-processor looks for, round the same
direction and as wide as that is unsure; and the nose, where that is wider than a gimbal reaches.
"""

import math
from dataclasses import dataclass, replace

from echowing.flight.axis import Axis, along, spread_rad, turns_rps
from echowing.flight.cloud import Between
from echowing.flight.estimate import Estimate
from echowing.flight.follower import FollowerState
from echowing.flight.known import Known
from echowing.geo import Ned, ned_between, wrap_angle_rad

# Under the first the direction is sure enough; a cone wider than the second would leave a leader
# straight ahead in half of our sonar's beam only. Not by the sonar's file: with half of its beam a
# lidar heard its leader for 0.45 of the time instead of 0.49 (`echowing sim echowing --seed 1-4
# --set sonar.file=lidar`).
SURE_RAD, WIDEST_RAD = math.radians(4.0), math.radians(10.0)
# Once round, by a gimbal: 30 deg/s at the widest, a tenth of what the servos can; and by the nose,
# where the sonar has no gimbal (ArduCopter turns by 60 deg/s).
ROUND_S, NOSE_ROUND_S = 2.0, 4.0
# Once through the figure 8: twelve points of 0.3 s (the co-processor's SCAN_DWELL).
FIGURE_S = 3.6
# So far a gimbal turns to each side (the co-processor's PAN_REACH).
REACH_RAD = math.radians(60.0)
# So far the nose looks to each side for a leader that is not heard, in this time there and back.
NOSE_RAD, NOSE_LOOKS_S = math.radians(45.0), 8.0
# A leader that is not heard for so long is looked for where it most likely is. The time counts up
# to the last reading that could be used, not up to now: with a slow radio that reading is a second
# old, and nothing is lost.
MISSED_S = 1.0
# One that has just been found may be another vehicle: by turns the sonar looks where whom it looks
# for would be then. The gimbal is there within 0.3 s, and a few readings are enough.
GLANCE_S = 0.8


@dataclass(frozen=True, slots=True)
class Look:
    """An axis, by how much it turns (azimuth, elevation), and its standard deviation.

    nose_rad: where the vehicle's nose looks for it; None: at the leader.
    """

    axis: Axis
    rate_rps: tuple[float, float]
    sigma_rad: float
    nose_rad: float | None = None


def look_at(known: Known, follower: FollowerState, now_s: float) -> Look | None:
    """Where its sonar looks from when the order arrives; None: that is not known."""
    arrives_s = now_s + follower.way_s
    leader, here = known.watched_then(follower, arrives_s), follower.then(arrives_s)
    if leader is None or here is None or known.leader_is_stale(now_s):
        return None
    estimate = follower.estimate
    north, east, _ = ned_between(here, leader.position)
    to_it_m = north, east, estimate.offset.up_m - known.watched_above_m(follower)
    look = Look(
        along(to_it_m), _rate_rps(to_it_m, leader.velocity_ned_mps, follower, arrives_s), 0.0
    )
    across_rad, up_rad = _unsure_rad(estimate, look.axis, to_it_m)
    look = replace(look, sigma_rad=max(across_rad, up_rad))
    by_nose = not estimate.points(now_s)
    glances = [] if by_nose else estimate.elsewhere_m
    lost = estimate.missed_s > MISSED_S + (GLANCE_S if glances else 0.0)
    reach_rad, round_s = (0.0, NOSE_ROUND_S) if by_nose else (REACH_RAD, ROUND_S)
    if lost:
        look = _by_turns(look, now_s)
        # Beside other followers the nose would lead the sonar to one of them.
        looks_round = by_nose or len(known.followers) == 1
        return _to_both_sides(look, 3.0 * across_rad - reach_rad, now_s) if looks_round else look
    turn = int(now_s / GLANCE_S)
    if glances and turn % 2:
        return _elsewhere(look, to_it_m, glances[turn // 2 % len(glances)])
    cone_rad = _wide_rad(across_rad), _wide_rad(up_rad)
    coned = _coned(look, cone_rad, now_s / round_s)
    return _with_nose(coned) if by_nose else coned


def _with_nose(look: Look) -> Look:
    return replace(look, nose_rad=look.axis.azimuth_rad)


def _rate_rps(
    to_it_m: Ned, its_mps: Ned, follower: FollowerState, at_s: float
) -> tuple[float, float]:
    """How fast the direction of a vehicle turns, by both vehicles' velocities."""
    own_north, own_east = follower.velocity_then(at_s)
    own_down = -follower.climb_mps
    past_mps = its_mps[0] - own_north, its_mps[1] - own_east, its_mps[2] - own_down
    return turns_rps(to_it_m, past_mps)


def _unsure_rad(estimate: Estimate, axis: Axis, to_it_m: Ned) -> tuple[float, float]:
    """Standard deviation of a direction, across and in height."""
    across_m = estimate.offset.sigma_m(axis.azimuth_rad + math.pi / 2.0)
    return spread_rad(across_m, to_it_m), spread_rad(estimate.offset.up_sigma_m, to_it_m)


def _coned(look: Look, cone_rad: tuple[float, float], rounds: float) -> Look:
    """The look on its way round the cone."""
    phase_rad = 2.0 * math.pi * rounds
    aside_rad, above_rad = cone_rad[0] * math.sin(phase_rad), cone_rad[1] * math.cos(phase_rad)
    axis = look.axis
    turned = Axis(wrap_angle_rad(axis.azimuth_rad + aside_rad), axis.elevation_rad + above_rad)
    return replace(look, axis=turned)


def _by_turns(look: Look, now_s: float) -> Look:
    """Every other round of the figure 8 half as wide: a narrow beam leaves gaps in a wide one."""
    narrow = now_s / FIGURE_S % 2.0 >= 1.0
    return replace(look, sigma_rad=0.5 * look.sigma_rad) if narrow else look


def _elsewhere(look: Look, to_it_m: Ned, further_m: Between) -> Look:
    """A look where the leader is if what seems to be it is another vehicle."""
    (north_m, east_m, down_m), (north, east, up) = to_it_m, further_m
    axis = along((north_m + north, east_m + east, down_m - up))
    return replace(look, axis=axis, rate_rps=(0.0, 0.0))


def _to_both_sides(look: Look, further_rad: float, now_s: float) -> Look:
    """A look with the nose for a leader that may be so much further aside than a gimbal reaches."""
    if further_rad <= 0.0:
        return look
    return _with_nose(_coned(look, (min(NOSE_RAD, further_rad), 0.0), now_s / NOSE_LOOKS_S))


def _wide_rad(unsure_rad: float) -> float:
    """How far the cone goes to a side."""
    return max(0.0, min(WIDEST_RAD, 2.0 * (unsure_rad - SURE_RAD)))
