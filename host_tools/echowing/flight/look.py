"""Where a sonar is to look: at its leader, and round it while its direction is unsure. Pure.

A leader that is always heard may be anywhere in the beam; the beam's edge passing over it shows
where. So the axis goes round the expected direction on a cone, as wide as the direction is unsure
across and in height. A leader that is not heard the co-processor looks for, round the same
direction and as wide as that is unsure.
"""

import math
from dataclasses import dataclass, replace

from echowing.flight.axis import Axis, along, spread_rad, turns_rps
from echowing.flight.cloud import Between
from echowing.flight.estimate import Estimate
from echowing.flight.state import FollowerState, Known
from echowing.geo import Ned, ned_between, wrap_angle_rad

# Under the first the direction is sure enough; a cone wider than the second would leave a leader
# straight ahead in half the beam only.
SURE_RAD, WIDEST_RAD = math.radians(4.0), math.radians(10.0)
# Once round, by a gimbal: 30 deg/s at the widest, a tenth of what the servos can; and by the nose,
# where the sonar has no gimbal (ArduCopter turns by 60 deg/s).
ROUND_S, NOSE_ROUND_S = 2.0, 4.0
# A point of the figure 8 (the co-processor's SCAN_DWELL); and the part of its whole width that is
# added from one to the next: by the golden ratio the widths of any few points are spread evenly.
DWELL_S, WIDER = 0.3, 0.618034
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
    """An axis, by how much it turns (azimuth, elevation), and its standard deviation."""

    axis: Axis
    rate_rps: tuple[float, float]
    sigma_rad: float


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
    if lost:
        return _to_both_sides(look, now_s) if by_nose else _narrower(look, now_s)
    turn = int(now_s / GLANCE_S)
    if glances and turn % 2:
        return _elsewhere(look, to_it_m, glances[turn // 2 % len(glances)])
    cone_rad = _wide_rad(across_rad), _wide_rad(up_rad)
    return _coned(look, cone_rad, now_s / (NOSE_ROUND_S if by_nose else ROUND_S))


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


def _narrower(look: Look, now_s: float) -> Look:
    """A look whose figure 8 is of another width at each point.

    Its points lie to the left, in the middle and to the right: always as wide as the direction is
    unsure, it would leave gaps between them that a narrow beam does not reach.
    """
    share = now_s // DWELL_S * WIDER % 1.0
    return replace(look, sigma_rad=share * look.sigma_rad)


def _elsewhere(look: Look, to_it_m: Ned, further_m: Between) -> Look:
    """A look where the leader is if what seems to be it is another vehicle."""
    (north_m, east_m, down_m), (north, east, up) = to_it_m, further_m
    axis = along((north_m + north, east_m + east, down_m - up))
    return replace(look, axis=axis, rate_rps=(0.0, 0.0))


def _to_both_sides(look: Look, now_s: float) -> Look:
    """A look for a leader that is not heard, by a sonar that no gimbal turns."""
    aside_rad = min(NOSE_RAD, 2.0 * look.sigma_rad)
    return _coned(look, (aside_rad, 0.0), now_s / NOSE_LOOKS_S)


def _wide_rad(unsure_rad: float) -> float:
    """How far the cone goes to a side."""
    return max(0.0, min(WIDEST_RAD, 2.0 * (unsure_rad - SURE_RAD)))
