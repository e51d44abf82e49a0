"""The plan: where a follower is to be, how fast, and where it looks. Pure."""

import math
from dataclasses import replace

from echowing.flight.estimate import HEARD_S
from echowing.flight.guidance import (
    GuidanceSettings,
    GuidedPoint,
    LeaderFix,
    bearing_rad,
    held_behind,
    lead_share,
    sway_rad,
)
from echowing.flight.handling import least_slot_m
from echowing.flight.search import swung
from echowing.flight.state import FollowerState, Known
from echowing.geo import displace, distance_m, ned_between, wrap_angle_rad

# A leader that the sonar does not hear is approached no faster than this. A copter stops from it
# within the beam's reach, even if the receivers are wrong.
JOIN_MPS, QUIET_S = 1.5, 0.5
# The tool learns late where a follower flies, and its answer takes as long again. With slow radios
# a leader therefore counts as heard for longer: by so many times the radio's delay.
QUIET_WAYS = 5.0
# It closes half of what is left in a second. With all of it in a second a follower on 4.8 still
# went back and forth by a metre, as its answer comes half a second late.
CATCH_UP_PER_S = 0.5
# To a leader that is heard: the point lies at most so far away, and the rest of the way is flown by
# speed. The first echoes often move the leader by a metre. Guided would close that with 20 degrees
# of roll, and the sonar would lose it again (SITL 4.8; one that turned round then came to 0.98 m).
NEAR_M, HEARD_PER_S = 0.3, 0.7
# A leader that is not heard gets more room, the less its place is known; but the follower stays so
# far within the sonar's reach.
WITHIN_REACH_M = 0.7
# A slot that was opened closes slowly: one that leans to catch up loses its leader.
CLOSES_MPS = 0.6
# A leader that is not heard for so long is looked for where it most likely is. The time counts up
# to the last reading that could be used, not up to now: with a slow radio that reading is a second
# old, and the nose would swing although nothing is lost.
LOST_S = 1.0
# Nearer to its slot than the first, a follower is in it; nearer than the second, it has arrived.
IN_SLOT_M, AT_SLOT_M = 1.0, 0.05


def planned(known: Known, follower: FollowerState, fix: LeaderFix, now_s: float) -> GuidedPoint:
    """The slot at the moment the point reaches the vehicle, and the point that leads to it.

    With feed-forward: the slot and its velocity. Position alone: a point ahead of the slot.
    """
    settings, least_m = known.settings, follower.reversal_m
    arrives_s = now_s + follower.way_s
    leader, here = _leader(known, follower, fix, arrives_s), follower.then(arrives_s)
    if settings.learn_offset:
        least_m = max(least_m, _least_radius_m(known, follower, now_s))
        if here is not None and distance_m(here, leader.position) > follower.plan.sonar.reach_m:
            follower.beyond_s = now_s
        if least_m > 0.0 and _is_overdue(follower, now_s):
            least_m = max(least_m, _reversal_by_radio_m(known, follower, fix))
    least_m = _closing_slowly(follower, least_m, now_s)
    guided = follower.guide.update(leader, arrives_s, here, least_m)
    guided = replace(guided, age_s=max(0.0, now_s - fix.time_s))
    # In a formation another follower may be where it would search.
    pointed = follower.estimate.points(now_s)
    if settings.learn_offset and len(known.followers) == 1 and not pointed:
        guided = _searching(known, follower, guided, now_s)
    if settings.feed_forward:
        guided = _gently(follower, _fading(guided, settings), now_s)
    elif settings.lead_time_s > 0.0:
        guided = _led(guided, leader, settings)
    if not settings.face_leader:
        return replace(guided, yaw_rad=None)
    if pointed:
        return guided
    return _looking_around(follower, guided, now_s)


def _searching(
    known: Known, follower: FollowerState, guided: GuidedPoint, now_s: float
) -> GuidedPoint:
    """The slot, swung round a leader that is not heard though it is within the sonar's reach."""
    here, estimate = follower.on_arrival(now_s), follower.estimate
    radius_m, sonar = follower.plan.slot.radius_m, follower.plan.sonar
    # From below or above the beam does not meet it from any side.
    half_rad = sonar.narrowest_rad.at(radius_m)
    level = abs(known.leader_above_m(follower)) < radius_m * math.tan(half_rad)
    within_reach = radius_m < sonar.reach_m and level
    unheard = estimate.missed_s > LOST_S
    rate_rps = follower.search.update(
        now_s,
        misses=unheard and within_reach and estimate.listens(now_s),
        in_slot=here is not None and distance_m(here, guided.slot) < IN_SLOT_M,
        new=math.isinf(estimate.missed_s),
    )
    return swung(guided, follower.search.aside_rad, rate_rps)


def _leader(known: Known, follower: FollowerState, fix: LeaderFix, at_s: float) -> LeaderFix:
    """The leader at a moment, in this follower's frame."""
    then = known.leader_then(follower, at_s) if known.settings.predict else None
    return then or known.seen_by(follower, fix)


def _least_radius_m(known: Known, follower: FollowerState, now_s: float) -> float:
    """How near the leader a slot may be, given what the sonar has not yet confirmed."""
    settings, offset = known.settings, follower.estimate.offset
    offset.advance(now_s)
    line_rad = known.bearing_of_leader(follower, now_s) or 0.0
    return offset.nearest_m(line_rad, settings.clearance_m)


def _is_overdue(follower: FollowerState, now_s: float) -> bool:
    """Whether the leader is not heard, though for a while it was within the sonar's reach.

    One that was heard, and is out of reach because the follower fell behind at a corner, is heard
    again on the way to the slot. If the slot opened meanwhile, it would stay out of reach.
    """
    estimate = follower.estimate
    fell_behind = math.isfinite(estimate.missed_s) and now_s - follower.beyond_s <= HEARD_S
    return not estimate.hears(now_s) and not fell_behind


def _reversal_by_radio_m(known: Known, follower: FollowerState, fix: LeaderFix) -> float:
    """The nearest slot from which it gets away from a reversal that only reports show.

    No further than the sonar's reach, less what the receivers may be off: beyond, the leader would
    never be heard again.
    """
    noticed_s = round(known.leader.oldest_s + follower.way_s, 1)
    speed_mps, answer = round(fix.speed_mps, 1), follower.handling.answer
    least_m = least_slot_m(
        speed_mps, answer, known.settings.clearance_m, noticed_s, known.leader_brakes_mps2
    )
    return min(follower.plan.sonar.reach_m - WITHIN_REACH_M, least_m)


def _closing_slowly(follower: FollowerState, least_m: float, now_s: float) -> float:
    """The least radius, which opens at once and closes at `CLOSES_MPS`."""
    elapsed_s = now_s - follower.least_at_s
    follower.least_m = max(least_m, follower.least_m - CLOSES_MPS * elapsed_s)
    follower.least_at_s = now_s
    return follower.least_m


def _fading(guided: GuidedPoint, settings: GuidanceSettings) -> GuidedPoint:
    """The slot's velocity, which fades as the leader's report grows old."""
    share = lead_share(guided.age_s, settings)
    north, east = guided.velocity_mps
    return replace(guided, velocity_mps=(share * north, share * east))


def _led(guided: GuidedPoint, leader: LeaderFix, settings: GuidanceSettings) -> GuidedPoint:
    """The slot moved along the formation's course by L1, for a point without a velocity.

    The leader's speed is taken along that course: if the leader flies back at its follower it is
    negative, and the point is further back than the slot.
    """
    cos, sin = math.cos(guided.course_rad), math.sin(guided.course_rad)
    north_mps, east_mps, _ = leader.velocity_ned_mps
    lead_s = settings.lead_time_s * lead_share(guided.age_s, settings)
    lead_m = lead_s * (north_mps * cos + east_mps * sin)
    offset_m = guided.offset_m[0] + lead_m * cos, guided.offset_m[1] + lead_m * sin
    if settings.tow_bar:
        offset_m = held_behind(offset_m, guided.course_rad, settings.clearance_m)
    up_m = guided.slot.alt_m - guided.leader.alt_m
    return replace(guided, point=displace(guided.leader, (*offset_m, -up_m)))


def _gently(follower: FollowerState, guided: GuidedPoint, now_s: float) -> GuidedPoint:
    """Send the way to a slot as a velocity: all of it to a leader that is not heard.

    A place ahead would be overshot: it moves on with the vehicle that flies towards it, and Guided
    closes the last metre so hard that the sonar, which leans with its vehicle, loses the leader.
    """
    here, unheard_s = follower.on_arrival(now_s), follower.estimate.offset.unheard_s(now_s)
    if here is None:
        return guided
    heard = unheard_s < QUIET_S + QUIET_WAYS * follower.way_s
    near_m = NEAR_M if heard else 0.0
    north, east, down = ned_between(here, guided.point)
    far_m = math.hypot(north, east)
    # Away from the leader nothing is too fast.
    away = distance_m(guided.point, guided.leader) >= distance_m(here, guided.leader)
    if away or far_m <= max(near_m, AT_SLOT_M):
        return guided
    slot_north, slot_east = guided.velocity_mps
    per_s = HEARD_PER_S if heard else CATCH_UP_PER_S
    pace = min(JOIN_MPS, per_s * (far_m - near_m)) / far_m
    ahead = near_m / far_m
    return replace(
        guided,
        point=displace(here, (ahead * north, ahead * east, down)),
        velocity_mps=(slot_north + pace * north, slot_east + pace * east),
    )


def _looking_around(follower: FollowerState, guided: GuidedPoint, now_s: float) -> GuidedPoint:
    """Turn the nose to where the leader most likely is, or to both sides to learn where."""
    offset, here = follower.estimate.offset, follower.position
    if guided.yaw_rad is None or here is None:
        return guided
    if follower.estimate.missed_s > LOST_S:
        north, east = offset.most_likely_m
        leader = displace(guided.leader, (offset.north_m - north, offset.east_m - east, 0.0))
        looks_rad = bearing_rad(here, leader) + follower.search.look_rad(now_s)
        return replace(guided, yaw_rad=wrap_angle_rad(looks_rad))
    across_m = offset.sigma_m(guided.yaw_rad + math.pi / 2.0)
    unsure_rad = across_m / max(1.0, distance_m(here, guided.leader))
    off_rad = sway_rad(unsure_rad, now_s)
    return replace(guided, yaw_rad=wrap_angle_rad(guided.yaw_rad + off_rad))
