"""Guidance: from what the leader reports to the guided point of one follower. Pure.

Bearings are radians clockwise from true north, horizontal vectors are (north, east) metres.
The plan follows thesis 3.4.1 and Appendix D (`follower_pos`): a *slot* at a radius and an angle
off the leader's tail, and a *guided point* that runs ahead of the slot by lead time x speed.
Bearings are compass bearings throughout; nothing here knows "relative to east", which is the
frame mix-up behind the thesis's north-south fault (Table 8).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from echowing.flight.swarm_rules import Weights
from echowing.geo import GlobalPosition, Ned, displace, ned_between, wrap_angle_rad

Horizontal = tuple[float, float]

# Thesis Appendix C: under 0.25 m/s the ground course is noise and the heading is used instead.
SLOW_MPS = 0.25
# Back to the course only above this, so that a leader near the limit does not switch to and fro.
MOVING_MPS = 0.35
# The guided point is never nearer to the leader than this; a slot inside could not be flown.
SMALLEST_RADIUS_M = 1.0


@dataclass(frozen=True, slots=True)
class Slot:
    """A place in the formation, behind the leader or behind another slot.

    radius_m: horizontal distance from who is there.
    angle_rad: off the leader's tail, counter-clockwise positive seen from above
        (so +90 degrees is on the leader's right).
    altitude_step_m: above the formation's altitude.
    behind: number, from 0, of the slot in the formation whose follower its sonar looks at, an
        earlier one; None: it looks at the leader.
    """

    radius_m: float
    angle_rad: float = 0.0
    altitude_step_m: float = 0.0
    behind: int | None = None


@dataclass(frozen=True, slots=True)
class LeaderFix:
    """One report of the leader: where it was at `time_s` on our clock.

    The acceleration is worked out from this report and the one before.
    """

    time_s: float
    position: GlobalPosition
    velocity_ned_mps: Ned
    heading_rad: float
    acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0)

    @property
    def speed_mps(self) -> float:
        """Horizontal speed."""
        return math.hypot(self.velocity_ned_mps[0], self.velocity_ned_mps[1])


@dataclass(frozen=True, slots=True)
class GuidanceSettings:
    """How guided points are made. The defaults are ours; `GRAY` is the thesis's scheme.

    tow_bar: the leader pulls the slot along on a bar (`flight.tow_bar`), and no point is ahead of
        the leader or within `clearance_m` of it. Without it the slot is fixed to the leader's tail.
    feed_forward: points carry the slot's velocity, and no lead.
    lead_time_s: points without a velocity run ahead of the slot by L1 = lead time x leader speed
        (thesis Appendix B).
    predict: carry the leader on, at its velocity and acceleration, over the age of the report.
    face_leader: send the bearing of the leader as yaw, so that the sonar looks at it.
    learn_offset: learn from the sonar how far the two receivers disagree (`flight`), move the
        leader by it, and stand off so far that `clearance_m` is left for certain
        (`cloud.Cloud.nearest_m`).
    swarm: how followers without slots are led; None: all have slots.
    close_gaps: who flies behind one that has left takes its slot (`flight.gaps`).
    fresh_age_s, stale_age_s: the lead shrinks to nothing between these ages of the report; beyond
        the second the follower is stopped. A velocity does not shrink: reports by telemetry radio
        are 0.46 to 0.71 s old, and who was told an eighth less than the leader's speed stayed half
        a metre behind its slot, out of the sonar's reach, for as long as it did not hear.
    """

    tow_bar: bool = True
    feed_forward: bool = True
    # A copter trails a moving point by 1.1 s (2.2 m at 2 m/s); half a period of the points, the
    # link and the share of the lead in force at this latency make it 1.4 s.
    lead_time_s: float = 1.4
    predict: bool = True
    clearance_m: float = SMALLEST_RADIUS_M
    face_leader: bool = True
    learn_offset: bool = True
    swarm: Weights | None = None
    close_gaps: bool = False
    fresh_age_s: float | None = 0.5
    stale_age_s: float | None = 1.0


GRAY = GuidanceSettings(
    tow_bar=False,
    feed_forward=False,
    lead_time_s=1.0,  # thesis 3.4.1
    predict=False,
    face_leader=False,
    learn_offset=False,
    fresh_age_s=None,
    stale_age_s=None,
)


@dataclass(frozen=True, slots=True)
class GuidedPoint:
    """What one follower is told: a point, and the bearing to look at (None: autopilot's choice).

    `slot` is the same without the lead; `leader` is where the leader is believed to be, or the slot
    behind which this one is; `offset_m` is from there to the slot, (north, east). Altitudes are on
    the leader's datum and carry the slot's altitude step. velocity_mps: to fly with the point,
    slot_mps: the slot's own, (north, east); course_rad: the formation's; at_s: when it is there.
    """

    point: GlobalPosition
    slot: GlobalPosition
    leader: GlobalPosition
    yaw_rad: float | None
    age_s: float = 0.0
    offset_m: Horizontal = (0.0, 0.0)
    velocity_mps: Horizontal = (0.0, 0.0)
    slot_mps: Horizontal = (0.0, 0.0)
    course_rad: float = 0.0
    at_s: float = 0.0


class Course:
    """Which way the leader points: its ground course while it moves, its heading while slow."""

    def __init__(self) -> None:
        self._moving = False

    def update(self, fix: LeaderFix) -> float:
        """The bearing to build the formation on, in radians (thesis Appendix C)."""
        threshold_mps = SLOW_MPS if self._moving else MOVING_MPS
        self._moving = fix.speed_mps >= threshold_mps
        if not self._moving:
            return fix.heading_rad
        return math.atan2(fix.velocity_ned_mps[1], fix.velocity_ned_mps[0])


def slot_offset_m(slot: Slot, course_rad: float) -> Horizontal:
    """The slot as seen from the leader, (north, east) metres.

    The tail is the bearing course + 180 deg; counter-clockwise from above lowers a bearing.
    """
    bearing_rad = course_rad + math.pi - slot.angle_rad
    return slot.radius_m * math.cos(bearing_rad), slot.radius_m * math.sin(bearing_rad)


def place_m(slots: Sequence[Slot], number: int, course_rad: float = 0.0) -> Ned:
    """Where a slot is, NED from the leader, while the formation flies straight on."""
    slot = slots[number]
    north_m, east_m = slot_offset_m(slot, course_rad)
    if slot.behind is not None:
        ahead_north_m, ahead_east_m, _ = place_m(slots, slot.behind, course_rad)
        north_m, east_m = north_m + ahead_north_m, east_m + ahead_east_m
    return north_m, east_m, -slot.altitude_step_m


def at_slot(
    slot: Slot, leader: LeaderFix, course_rad: float, follower: GlobalPosition | None
) -> GuidedPoint:
    """The slot behind a leader, at the leader's velocity; looks at it from the follower's place.

    follower: where it is (the slot, where that is not known).
    """
    offset_m = slot_offset_m(slot, course_rad)
    place = displace(leader.position, (*offset_m, -slot.altitude_step_m))
    return GuidedPoint(
        point=place,
        slot=place,
        leader=leader.position,
        yaw_rad=bearing_rad(follower or place, leader.position),
        offset_m=offset_m,
        velocity_mps=leader.velocity_ned_mps[:2],
        course_rad=course_rad,
    )


def carried_round(leader_mps: Horizontal, rate_rps: float, offset_m: Horizontal) -> Horizontal:
    """The velocity of a place on a body that moves with the leader and turns (clockwise)."""
    return leader_mps[0] - rate_rps * offset_m[1], leader_mps[1] + rate_rps * offset_m[0]


def turned_towards(from_rad: float, to_rad: float, most_rad: float) -> float:
    """`from_rad` turned the short way towards `to_rad`, by `most_rad` at the most."""
    turn_rad = wrap_angle_rad(to_rad - from_rad)
    return wrap_angle_rad(from_rad + max(-most_rad, min(most_rad, turn_rad)))


def held_behind(offset_m: Horizontal, course_rad: float, clearance_m: float) -> Horizontal:
    """An offset from the leader moved straight back until it is neither ahead nor too near.

    Only the part along the course is changed, so a point never slides sideways round the leader.
    """
    cos, sin = math.cos(course_rad), math.sin(course_rad)
    ahead_m = offset_m[0] * cos + offset_m[1] * sin
    right_m = -offset_m[0] * sin + offset_m[1] * cos
    furthest_m = -math.sqrt(max(0.0, clearance_m**2 - right_m**2))
    back_m = max(0.0, ahead_m - furthest_m)
    return offset_m[0] - back_m * cos, offset_m[1] - back_m * sin


def lead_share(age_s: float, settings: GuidanceSettings) -> float:
    """The part of the lead time in force for a report this old: 1 when fresh, 0 when stale."""
    if settings.fresh_age_s is None or settings.stale_age_s is None:
        return 1.0
    span_s = settings.stale_age_s - settings.fresh_age_s
    return max(0.0, min(1.0, (settings.stale_age_s - age_s) / span_s))


def is_stale(age_s: float, settings: GuidanceSettings) -> bool:
    """Whether a report this old must stop the follower."""
    return settings.stale_age_s is not None and age_s > settings.stale_age_s


def between(a: Horizontal, b: Horizontal, share: float) -> Horizontal:
    """From `a` this share of the way to `b`."""
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])


def bearing_rad(start: GlobalPosition, end: GlobalPosition) -> float:
    """Bearing from one position to another nearby."""
    north_m, east_m, _ = ned_between(start, end)
    return math.atan2(east_m, north_m)


def predicted(fix: LeaderFix, age_s: float) -> LeaderFix:
    """The leader `age_s` after its report, at the velocity and the acceleration it had."""
    (vn, ve, vd), (an, ae, ad) = fix.velocity_ned_mps, fix.acceleration_ned_mps2
    gain_s2 = age_s * age_s
    moved_m = (
        vn * age_s + an * gain_s2 / 2.0,
        ve * age_s + ae * gain_s2 / 2.0,
        vd * age_s + ad * gain_s2 / 2.0,
    )
    return LeaderFix(
        fix.time_s,
        displace(fix.position, moved_m),
        (vn + an * age_s, ve + ae * age_s, vd + ad * age_s),
        fix.heading_rad,
        fix.acceleration_ned_mps2,
    )
