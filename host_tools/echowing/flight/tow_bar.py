"""The plan: a slot that the leader pulls along as a car pulls a trailer. Pure.

The bar between leader and slot has the slot's length. Its bearing turns only as the leader's end
moves across it, at v / length x sin(course - bearing); the slot moves along the bar. So a slot on
the tail never moves faster than the leader, the distance is kept through corners, a leader that
turns its nose moves nobody, and one that flies back pushes its follower straight back instead of
sending it round. Slots side by side hang on bars of one length,
so that their formation turns as one body.

A bar that is pushed buckles, as a trailer's does. So a lone follower comes round its leader, and is
behind it again. In a formation the bars would buckle to both sides, and send followers across each
other's way; so its leader pushes them straight back as they are, and they fly ahead of it.
"""

import math
from dataclasses import replace

from echowing.flight.guidance import (
    GuidedPoint,
    Horizontal,
    LeaderFix,
    Slot,
    at_slot,
    bearing_rad,
    carried_round,
    turned_towards,
)
from echowing.geo import GlobalPosition, wrap_angle_rad

# Below it the course is noise and the bar does not turn (thesis Appendix C takes 0.25 m/s for the
# course itself; the bar turns in proportion to the speed, which fades the noise by itself).
STILL_MPS = 0.1
# A slot waits for its follower: it is never further round the leader than this, so that the
# straight way to it stays clear of the leader (3 m x cos 30 deg = 2.6 m in a 3 m formation).
FURTHEST_ROUND_RAD = math.radians(60.0)
# A leader that flies within this of straight back pushes its formation: halfway between that and
# across, as at a mission's corner.
PUSHED_RAD = math.radians(45.0)
# Ticks come at 8 Hz; after a longer pause the bar begins from where it is.
LONGEST_STEP_S = 1.0


class TowBar:
    """The slot of one follower behind its leader; holds the bar's bearing.

    slot: its place, away from the leader; length_m: of the bar, for a
    formation see `state.place_guides`; None: the slot's radius.
    """

    def __init__(self, slot: Slot, length_m: float | None = None) -> None:
        self.slot = slot
        self.length_m = slot.radius_m if length_m is None else length_m
        self._course_rad: float | None = None
        self._at_s = 0.0

    def place(self, slot: Slot, bar_m: float) -> None:
        """Set another slot, and the length of its bar, whose bearing stays."""
        self.slot, self.length_m = slot, bar_m

    def update(
        self,
        leader: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
        formation_mps: Horizontal | None = None,
    ) -> GuidedPoint:
        """The slot and its velocity, for a leader that is already carried on to its moment.

        follower: where the follower is then (the slot, where that is not known); the slot is
        `least_radius_m` from the leader at least. formation_mps: the velocity, (north, east), of
        the leader of a formation, also for a slot that is behind another one; None: a lone
        follower's bar.
        """
        slot = self.slot
        if slot.radius_m < least_radius_m:
            slot = replace(slot, radius_m=least_radius_m)
        length_m = self.length_m * slot.radius_m / self.slot.radius_m
        course_rad, rate_rps = self._turn(leader, now_s, follower, length_m, formation_mps)
        guided = at_slot(slot, leader, course_rad, follower)
        velocity_mps = carried_round(guided.velocity_mps, rate_rps, guided.offset_m)
        return replace(guided, velocity_mps=velocity_mps)

    def _turn(
        self,
        leader: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None,
        length_m: float,
        formation_mps: Horizontal | None,
    ) -> tuple[float, float]:
        """The bearing in which the bar points, and the rate at which it turns."""
        elapsed_s = min(LONGEST_STEP_S, max(0.0, now_s - self._at_s))
        self._at_s = now_s
        own_rad = None
        if follower is not None:
            own_rad = bearing_rad(leader.position, follower) + math.pi + self.slot.angle_rad
        if self._course_rad is None:
            self._course_rad = leader.heading_rad if own_rad is None else own_rad
        pushed = formation_mps is not None and _is_pushed(formation_mps, self._course_rad)
        rate_rps = 0.0 if pushed else _turn_rate_rps(leader, self._course_rad, length_m)
        turned_rad = wrap_angle_rad(self._course_rad + rate_rps * elapsed_s)
        if own_rad is not None:
            turned_rad = turned_towards(own_rad, turned_rad, FURTHEST_ROUND_RAD)
        self._course_rad = turned_rad
        return turned_rad, rate_rps


def _is_pushed(leader_mps: Horizontal, course_rad: float) -> bool:
    """Whether the leader of a formation flies back at it."""
    north_mps, east_mps = leader_mps
    back_mps = -north_mps * math.cos(course_rad) - east_mps * math.sin(course_rad)
    return back_mps > math.cos(PUSHED_RAD) * math.hypot(north_mps, east_mps)


def _turn_rate_rps(leader: LeaderFix, course_rad: float, length_m: float) -> float:
    """How fast the leader's end turns the bar."""
    north_mps, east_mps, _ = leader.velocity_ned_mps
    if leader.speed_mps < STILL_MPS:
        return 0.0
    across_mps = east_mps * math.cos(course_rad) - north_mps * math.sin(course_rad)
    return across_mps / length_m
