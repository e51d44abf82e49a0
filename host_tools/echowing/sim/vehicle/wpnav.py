"""Auto missions as ArduCopter flies them: straight legs with S-curve speed, corners cut by overlap.

A leg is a speed profile along a straight line whose jerk rises and falls as a raised cosine
(libraries/AP_Math/SCurve.cpp). Near a waypoint the next leg starts before this one has ended, and
the two motions add up: that cuts the corner (libraries/AC_WPNav/AC_WPNav.cpp).
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, pi, radians, sin, sqrt

from echowing.sim.vehicle.shaping import clamp

Ned = tuple[float, float, float]

# A leg shorter than this has no direction worth flying along.
SHORTEST_LEG_M = 1e-3
# Halvings that narrow the peak acceleration of a profile down to the last bits of a float.
BISECTIONS = 50
# The point on the track may run at the vehicle's own progress and this much more (AC_WPNav.cpp).
PROGRESS_BUFFER = 0.05
INPUT_S = 0.15  # ATC_INPUT_TC


@dataclass(frozen=True, slots=True)
class LeanLimits:
    """How far and how quickly it leans; infinite: no limit. The defaults are ArduCopter's."""

    most_rad: float = pi / 6.0  # ATC_ANGLE_MAX 30 degrees, or PSC_ANGLE_MAX
    input_s: float = INPUT_S
    rate_rps: float = inf  # ATC_RATE_R_MAX and P_MAX 0
    acceleration_rps2: float = radians(1100.0)  # ATC_ACC_R_MAX and P_MAX


@dataclass(frozen=True, slots=True)
class TrackLimits:
    """Limits of a mission's legs and of Guided; the defaults are ArduCopter 4.8's parameters."""

    acceleration_mps2: float = 2.5  # WP_ACC
    vertical_acceleration_mps2: float = 1.0  # WP_ACC_Z
    corner_acceleration_mps2: float = 5.0  # WP_ACC_CNR 0 stands for twice WP_ACC
    jerk_mps3: float = 1.0  # WP_JERK
    climb_mps: float = 2.5  # WP_SPD_UP
    descent_mps: float = 1.5  # WP_SPD_DN
    radius_m: float = 2.0  # WP_RADIUS_M
    shaping_jerk_mps3: float = 5.0  # PSC_JERK_NE: Guided; a mission's legs keep WP_JERK
    down_jerk_mps3: float = 5.0  # PSC_JERK_D
    lean: LeanLimits = LeanLimits()

    @property
    def snap_mps4(self) -> float:
        """Half of what brings WP_JERK up within ATC_INPUT_TC by a raised cosine (AC_WPNav.cpp)."""
        return 0.5 * self.jerk_mps3 * pi / (2.0 * INPUT_S)


def along_limit(direction: Ned, horizontal: float, up: float, down: float) -> float:
    """Largest value along a unit vector (NED) that keeps its parts within the limits.

    A limit of 0 anywhere makes the result 0, which ArduPilot reads as no limit.
    """
    if horizontal <= 0.0 or up <= 0.0 or down <= 0.0:
        return 0.0
    level = sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    vertical = direction[2]
    limits = []
    if level > 0.0:
        limits.append(horizontal / level)
    if vertical != 0.0:
        limits.append(down / vertical if vertical > 0.0 else up / -vertical)
    return min(limits, default=0.0)


class _Segment:
    """A stretch of time with one shape of jerk; evaluates speed and distance along the leg."""

    __slots__ = ("acceleration", "beta", "distance", "half_jerk", "speed", "start_s", "wave")

    def __init__(self, start_s: float, state: tuple[float, float, float]) -> None:
        self.start_s = start_s
        self.acceleration, self.speed, self.distance = state
        self.half_jerk = 0.0
        self.wave = 0.0
        self.beta = 1.0

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Acceleration, speed, distance (SI, along the leg) at a time of the leg."""
        t = time_s - self.start_s
        a, v, half = self.acceleration, self.speed, self.half_jerk
        if half == 0.0:
            return a, v + a * t, self.distance + (v + 0.5 * a * t) * t
        wave, beta = self.wave, self.beta
        sine = wave * sin(beta * t) / beta
        swing = wave * (1.0 - cos(beta * t)) / (beta * beta)
        drift = (wave * t - sine) / (beta * beta)
        return (
            a + half * (t + sine),
            v + a * t + half * (0.5 * t * t + swing),
            self.distance + (v + 0.5 * a * t) * t + half * (t * t * t / 6.0 + drift),
        )


@dataclass(frozen=True, slots=True)
class _SpeedChange:
    """Times of a change of speed: jerk ramps of `ramp_s`, holds of `hold_s`, `steady_s` between."""

    jerk: float = 0.0
    ramp_s: float = 0.0
    hold_s: float = 0.0
    steady_s: float = 0.0


def _jerk_block(
    peak: float, start_speed: float, jerk: float, snap: float
) -> tuple[float, float, float]:
    """Jerk, ramp and hold time that bring the acceleration from zero to `peak`."""
    ramp_s = jerk * pi / (2.0 * snap)
    if peak >= jerk * ramp_s:
        return jerk, ramp_s, peak / jerk - ramp_s
    if start_speed == 0.0:
        ramp_s = sqrt(peak * pi / (2.0 * snap))
    return peak / ramp_s, ramp_s, 0.0


def _plan_change(
    start_speed: float,
    end_speed: float,
    room_m: float,
    acceleration: float,
    jerk: float,
    snap: float,
) -> _SpeedChange:
    """Quickest way up to `end_speed` within `room_m`; ends slower if there is not enough room."""
    gain = end_speed - start_speed
    if gain <= 0.0 or room_m <= 0.0:
        return _SpeedChange()

    def block_s(peak: float) -> float:
        _, ramp_s, hold_s = _jerk_block(peak, start_speed, jerk, snap)
        return 2.0 * ramp_s + hold_s

    def fits(peak: float) -> bool:
        time_s = block_s(peak)
        travelled = (start_speed + 0.5 * peak * time_s) * 2.0 * time_s
        return peak * time_s <= gain and travelled <= room_m

    low, high = 0.0, acceleration
    if fits(high):
        low = high
    for _ in range(BISECTIONS if low < high else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    if low <= 0.0:
        return _SpeedChange()
    time_s = block_s(low)
    # (v + A (T + s) / 2) (2 T + s) = room, solved for the steady time s
    half = start_speed / low + 1.5 * time_s
    rest = 2.0 * (room_m - (start_speed + 0.5 * low * time_s) * 2.0 * time_s) / low
    room_s = -half + sqrt(half * half + max(0.0, rest))
    steady_s = max(0.0, min(gain / low - time_s, room_s))
    used_jerk, ramp_s, hold_s = _jerk_block(low, start_speed, jerk, snap)
    return _SpeedChange(used_jerk, ramp_s, hold_s, steady_s)


class Leg:
    """Motion from one waypoint to the next along a straight line, starting and ending at rest."""

    __slots__ = (
        "_cruise_s",
        "_limits",
        "_segments",
        "_starts",
        "accelerated_s",
        "braking_s",
        "delta_m",
        "direction",
        "elapsed_s",
        "end_s",
        "length_m",
        "speed_mps",
        "vertical_acceleration_mps2",
    )

    def __init__(
        self, origin: Ned, destination: Ned, speed_mps: float, limits: TrackLimits
    ) -> None:
        delta = (
            destination[0] - origin[0],
            destination[1] - origin[1],
            destination[2] - origin[2],
        )
        self.delta_m = delta
        self.length_m = _length(delta)
        length = self.length_m or 1.0
        self.direction = (delta[0] / length, delta[1] / length, delta[2] / length)
        self.elapsed_s = 0.0
        self.vertical_acceleration_mps2 = limits.vertical_acceleration_mps2
        self._limits = limits
        self._plan(speed_mps, 0.0, (0.0, 0.0, 0.0))

    def _top_speed(self, speed_mps: float) -> float:
        limits = self._limits
        return along_limit(self.direction, speed_mps, limits.climb_mps, limits.descent_mps)

    def _acceleration(self) -> float:
        limits = self._limits
        vertical = limits.vertical_acceleration_mps2
        return along_limit(self.direction, limits.acceleration_mps2, vertical, vertical)

    def _plan(self, speed_mps: float, start_s: float, state: tuple[float, float, float]) -> None:
        """Profile from a state of constant speed to rest at the end of the leg."""
        _, start_speed, start_m = state
        limits, acceleration = self._limits, self._acceleration()
        jerk, snap = limits.jerk_mps3, limits.snap_mps4
        self.speed_mps = self._top_speed(speed_mps)
        self._segments = [_Segment(start_s, state)]
        self.end_s = start_s
        room = 0.5 * (self.length_m - start_m)
        if self.speed_mps >= start_speed:
            self._append(_plan_change(start_speed, self.speed_mps, room, acceleration, jerk, snap))
        else:
            back = _plan_change(self.speed_mps, start_speed, room, acceleration, jerk, snap)
            self._append(back, -1.0)
        self.accelerated_s = self.end_s
        _, cruise, reached_m = self._segments[-1].at(self.end_s)
        brake = _plan_change(0.0, cruise, self.length_m - reached_m, acceleration, jerk, snap)
        brake_s = 4.0 * brake.ramp_s + 2.0 * brake.hold_s + brake.steady_s
        left_m = self.length_m - reached_m - 0.5 * cruise * brake_s
        self._start_segment()
        self.end_s += max(0.0, left_m) / cruise if cruise > 0.0 else 0.0
        self.braking_s = self.end_s
        self._append(brake, -1.0)
        self._starts = [segment.start_s for segment in self._segments]

    def _start_segment(self) -> _Segment:
        previous = self._segments[-1]
        segment = _Segment(self.end_s, previous.at(self.end_s))
        self._segments.append(segment)
        return segment

    def _append(self, change: _SpeedChange, sign: float = 1.0) -> None:
        if change.ramp_s <= 0.0:
            return
        self._append_block(change, sign)
        self._start_segment()
        self.end_s += change.steady_s
        self._append_block(change, -sign)
        self._start_segment().acceleration = 0.0

    def _append_block(self, change: _SpeedChange, sign: float) -> None:
        parts = ((change.ramp_s, -1.0, 0.5), (change.hold_s, 0.0, 1.0), (change.ramp_s, 1.0, 0.5))
        for duration_s, wave, share in parts:
            segment = self._start_segment()
            segment.half_jerk = sign * share * change.jerk
            segment.wave = wave
            segment.beta = pi / change.ramp_s
            self.end_s += duration_s

    def set_speed(self, speed_mps: float) -> None:
        """Fly the rest of this leg at another speed; a leg that already brakes is left alone."""
        if self.elapsed_s >= self.braking_s and self.elapsed_s > 0.0:
            return
        if self.elapsed_s == 0.0:
            self._plan(speed_mps, 0.0, (0.0, 0.0, 0.0))
            return
        start_s = max(self.elapsed_s, self.accelerated_s)
        kept = [segment for segment in self._segments if segment.start_s < start_s]
        _, speed, distance = self._at(start_s)
        self._plan(speed_mps, start_s, (0.0, speed, distance))
        self._segments = kept + self._segments
        self._starts = [segment.start_s for segment in self._segments]

    def _at(self, time_s: float) -> tuple[float, float, float]:
        index = max(0, bisect_right(self._starts, time_s) - 1)
        return self._segments[index].at(min(time_s, self.end_s))

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Acceleration, speed and distance (SI) along the leg at a time of the leg."""
        if time_s >= self.end_s:
            return 0.0, 0.0, self.length_m
        return self._at(time_s)

    def advance(self, dt_s: float) -> tuple[float, float, float]:
        """Move on by dt and give acceleration, speed and distance there."""
        self.elapsed_s = min(self.elapsed_s + dt_s, self.end_s)
        return self.at(self.elapsed_s)

    @property
    def remaining_s(self) -> float:
        """Time to the end of the leg."""
        return self.end_s - self.elapsed_s


class _Target:
    """Sum of the motions of the legs in force: position, velocity, acceleration, NED."""

    __slots__ = ("acceleration", "position", "velocity")

    def __init__(self, position: Ned) -> None:
        self.position = position
        self.velocity: Ned = (0.0, 0.0, 0.0)
        self.acceleration: Ned = (0.0, 0.0, 0.0)

    def add(self, leg: Leg, motion: tuple[float, float, float]) -> None:
        acceleration, speed, distance = motion
        self.acceleration = _further(self.acceleration, acceleration, leg.direction)
        self.velocity = _further(self.velocity, speed, leg.direction)
        self.position = _further(self.position, distance, leg.direction)


def _further(start: Ned, way: float, direction: Ned) -> Ned:
    (north, east, down), (along_n, along_e, along_d) = start, direction
    return north + way * along_n, east + way * along_e, down + way * along_d


def _length(vector: Ned) -> float:
    north, east, down = vector
    return sqrt(north * north + east * east + down * down)


def _dot(a: Ned, b: Ned) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class WaypointNavigator:
    """Leads a point along a mission's legs: what Auto hands to its position controller.

    Frame: NED metres of the estimate. Legs start at `start_m` at rest; the last waypoint is a stop.
    """

    __slots__ = (
        "_legs",
        "_limits",
        "_origin",
        "_previous",
        "_progress",
        "_speed_mps",
        "_waypoints",
        "acceleration_mps2",
        "finished",
        "position_m",
        "velocity_mps",
        "waypoint_index",
    )

    def __init__(
        self,
        start_m: Ned,
        waypoints_m: Sequence[Ned],
        speed_mps: float,
        limits: TrackLimits | None = None,
    ) -> None:
        self._limits = limits or TrackLimits()
        self._speed_mps = speed_mps
        self._waypoints = [tuple(map(float, point)) for point in waypoints_m]
        self._origin: Ned = start_m
        self._previous: Leg | None = None
        self._progress = 1.0
        self._legs: list[Leg] = []
        self.waypoint_index = 0
        self.finished = False
        self.position_m: Ned = start_m
        self.velocity_mps: Ned = (0.0, 0.0, 0.0)
        self.acceleration_mps2: Ned = (0.0, 0.0, 0.0)
        self._fill()

    def _fill(self) -> None:
        """Keep this leg and the next one planned; skip waypoints that are where we already are."""
        while len(self._legs) < 2 and self.waypoint_index + len(self._legs) < len(self._waypoints):
            index = self.waypoint_index + len(self._legs)
            begin = self._waypoints[index - 1] if self._legs else self._origin
            leg = Leg(begin, self._waypoints[index], self._speed_mps, self._limits)  # type: ignore[arg-type]
            if leg.length_m < SHORTEST_LEG_M:
                del self._waypoints[index]
                continue
            self._legs.append(leg)
        self.finished = not self._legs

    def set_speed(self, speed_mps: float) -> None:
        """Change the mission's speed from here on."""
        self._speed_mps = speed_mps
        for leg in self._legs:
            leg.set_speed(speed_mps)

    def advance(
        self, dt_s: float, position_m: Ned, gap_m: Ned, velocity_mps: Ned, position_gain: float
    ) -> None:
        """Move the point on by dt.

        `position_m`: where the vehicle believes to be; `gap_m`: the position error its controller
        saw last; `velocity_mps`: its velocity (all NED). The point waits for a vehicle that falls
        behind.
        """
        if self.finished:
            return
        self._progress_with(dt_s, gap_m, velocity_mps, position_gain)
        step_s = dt_s * self._progress
        target = _Target(self._origin)
        leg = self._legs[0]
        following = self._legs[1] if len(self._legs) > 1 else None
        if self._previous is not None:
            # what the previous leg still has to go, seen from its end
            acceleration, speed, distance = self._previous.advance(step_s)
            target.add(self._previous, (acceleration, speed, distance - self._previous.length_m))
        target.add(leg, leg.advance(step_s))
        reached = leg.elapsed_s >= leg.end_s
        if following is not None:
            reached = self._blend(leg, following, step_s, target) or reached
        self._publish(target)
        if reached and (following is not None or self._near(position_m, leg)):
            self._next_leg()

    def _publish(self, target: _Target) -> None:
        self.position_m = target.position
        self.velocity_mps = target.velocity
        self.acceleration_mps2 = target.acceleration

    def _blend(self, leg: Leg, following: Leg, step_s: float, target: _Target) -> bool:
        """Start the next leg early if the corner stays within its limits; True past its middle."""
        if following.elapsed_s == 0.0:
            if self._may_turn(leg, following):
                target.add(following, following.advance(step_s))
            return False
        target.add(following, following.advance(step_s))
        return following.elapsed_s >= leg.remaining_s

    def _may_turn(self, leg: Leg, following: Leg) -> bool:
        left_s = leg.remaining_s
        if leg.elapsed_s < leg.braking_s or left_s > following.accelerated_s:
            return False
        middle = _Target((-leg.delta_m[0], -leg.delta_m[1], -leg.delta_m[2]))
        middle.add(leg, leg.at(leg.elapsed_s + 0.5 * left_s))
        middle.add(following, following.at(0.5 * left_s))
        slowest = min(leg.speed_mps, following.speed_mps)
        vertical = min(leg.vertical_acceleration_mps2, following.vertical_acceleration_mps2)
        return (
            _length(middle.position) < self._limits.radius_m
            and _length(middle.velocity) < slowest
            and _length((*middle.acceleration[:2], 0.0)) < self._limits.corner_acceleration_mps2
            and abs(middle.acceleration[2]) < vertical
        )

    def _progress_with(
        self, dt_s: float, gap_m: Ned, velocity_mps: Ned, position_gain: float
    ) -> None:
        """Let the point's clock slow down when the vehicle cannot keep up (AC_WPNav.cpp)."""
        wanted = self.velocity_mps
        speed = _length(wanted)
        ratio = 1.0
        if speed > 0.0:
            behind = _dot(gap_m, wanted) / speed
            flown = _dot(velocity_mps, wanted) / speed
            ratio = clamp(PROGRESS_BUFFER + (flown - position_gain * behind) / speed, 0.0, 1.0)
        time_constant_s = self._limits.acceleration_mps2 / self._limits.jerk_mps3
        self._progress += (ratio - self._progress) * min(1.0, dt_s / time_constant_s)

    def _near(self, position_m: Ned, leg: Leg) -> bool:
        left = _further(_further(self._origin, 1.0, leg.delta_m), -1.0, position_m)
        return _length(left) <= self._limits.radius_m

    def _next_leg(self) -> None:
        leg = self._legs.pop(0)
        self._origin = self._waypoints[self.waypoint_index]  # type: ignore[assignment]
        self.waypoint_index += 1
        self._previous = leg
        self._fill()
        if self.finished:
            self.velocity_mps = (0.0, 0.0, 0.0)
            self.acceleration_mps2 = (0.0, 0.0, 0.0)
            self.position_m = self._origin
