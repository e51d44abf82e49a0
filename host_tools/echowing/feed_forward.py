"""Position and velocity points, and the rule that keeps their follower off the leader. Pure.

A point with a velocity is flown at that velocity whatever the speed limit says: the limit caps only
the correction. So where `follow` sends such points the applet cannot slow the vehicle, and the
sender keeps the distance itself, by the sonar's DISTANCE_SENSOR and by the applet's rule. Without a
leader in the sonar's ear it sends the position alone, and the limit holds again.
"""

import math
from typing import Any

from echowing.geo import GlobalPosition, displace, ned_between
from echowing.guidance import (
    GuidanceSettings,
    GuidedPoint,
    Horizontal,
    held_behind,
    lead_share,
)

# The applet's rule in its own figures (lua/echowing.lua): ECHO_CLOSE, ECHO_DELAY, ECHO_DECEL,
# ECHO_LOST_T, and its constants of the same names.
CLOSE_M = 1.5
DELAY_S = 0.6
DECEL_MPS2 = 2.5
LOST_S = 1.3
HARD_CLOSE_M = 1.0
CLEAR_M = 0.3
BLIND_S = 2.5
EVADE_LEAST_M, EVADE_MOST_M = 0.5, 5.0
# Whatever the receivers say, a point draws its follower no further under the wanted range.
SLACK_M = 0.5
# A longer way to the vehicle than this is not led over: the leader may have turned by then.
LONGEST_WAY_S = 0.5
# From where a range is no target (thesis 3.3.3: an X8 gives a consistent return out to 4.5 m).
DETECTION_LIMIT_M = 4.5


def sonar_range_m(message: Any) -> float | None:
    """The range in a DISTANCE_SENSOR; None: the sonar hears no target."""
    range_m = float(message.current_distance) / 100.0
    nothing = range_m >= min(DETECTION_LIMIT_M, message.max_distance / 100.0)
    return None if nothing else range_m


def closing_distance_m(closing_mps: float, delay_s: float) -> float:
    """What is still closed at this rate until the vehicle stands, `delay_s` from now on."""
    closing_mps = max(0.0, closing_mps)
    return closing_mps * delay_s + closing_mps * closing_mps / (2.0 * DECEL_MPS2)


class Keeper:
    """One follower's distance to its leader by the sonar."""

    def __init__(self) -> None:
        self.too_close = False
        self._range_m = math.inf
        self._seen_at_s = -math.inf

    def heard(self, now_s: float, range_m: float | None) -> None:
        """Take a reading; None: no target."""
        if range_m is not None:
            self._range_m, self._seen_at_s = range_m, now_s

    def sees(self, now_s: float) -> bool:
        """Whether the leader has been heard lately."""
        return now_s - self._seen_at_s < LOST_S

    def range_m(self, now_s: float, closing_mps: float) -> float:
        """The range carried on from the newest reading."""
        return self._range_m - closing_mps * (now_s - self._seen_at_s)

    def judge(self, now_s: float, closing_mps: float, way_s: float) -> bool:
        """Whether it is too close now; `way_s`: to the vehicle and back.

        While it backs off its nose is up and the sonar often hears nothing: the last reading is
        carried on for longer then.
        """
        known_s = BLIND_S if self.too_close else LOST_S
        if now_s - self._seen_at_s >= known_s:
            self.too_close = False
            return False
        range_m = self.range_m(now_s, closing_mps)
        margin_m = CLEAR_M if self.too_close else 0.0
        stop_m = range_m - closing_distance_m(closing_mps, DELAY_S + way_s)
        self.too_close = range_m < HARD_CLOSE_M + margin_m or stop_m < CLOSE_M + margin_m
        return self.too_close


def retreat_m(wanted_m: float, range_m: float, approach_mps: float) -> float:
    """How far back to fly: to the wanted range, and the leader's approach of one second more."""
    back_m = wanted_m - range_m + max(0.0, approach_mps)
    return max(EVADE_LEAST_M, min(EVADE_MOST_M, back_m))


def backed_off(here: GlobalPosition, heading_rad: float, back_m: float) -> GlobalPosition:
    """The place so far straight behind a vehicle."""
    return displace(here, (-back_m * math.cos(heading_rad), -back_m * math.sin(heading_rad), 0.0))


def no_further(
    point: GlobalPosition, here: GlobalPosition, heading_rad: float, most_m: float
) -> GlobalPosition:
    """The point moved straight back until it is no further ahead of a vehicle than that."""
    north_m, east_m, _ = ned_between(here, point)
    ahead_m = north_m * math.cos(heading_rad) + east_m * math.sin(heading_rad)
    return backed_off(point, heading_rad, max(0.0, ahead_m - most_m))


def moving_slot(
    guided: GuidedPoint, settings: GuidanceSettings, way_s: float
) -> tuple[GlobalPosition, Horizontal]:
    """The slot when the point reaches the vehicle `way_s` from now, and its velocity (north, east).

    The velocity fades as the leader's report grows old, and the point is kept behind the leader as
    every guided point is.
    """
    share = lead_share(guided.age_s, settings)
    velocity = guided.velocity_mps[0] * share, guided.velocity_mps[1] * share
    north_m, east_m, down_m = ned_between(guided.leader, guided.slot)
    way_s = min(way_s, LONGEST_WAY_S)
    offset_m = north_m + velocity[0] * way_s, east_m + velocity[1] * way_s
    if settings.keep_behind:
        offset_m = held_behind(offset_m, guided.course_rad, settings.clearance_m)
    return displace(guided.leader, (*offset_m, down_m)), velocity
