"""Kinematic shaping: how ArduPilot turns an error into a smooth demand.

The laws are those of libraries/AP_Math/control.cpp: one set for ArduCopter up to 4.7 (`STEPPED`),
one for 4.8 (`PREDICTIVE`). Everything is a plain function of scalars, because these run fifty
times a simulated second and vehicle.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians, sqrt

from echowing.flight.closing import sqrt_controller

# Before braking and cornering are weighed against each other the demand is cut to this many times
# the limit, so that a huge along-track demand does not hide the cross-track one (control.cpp).
CORNER_PRE_LIMIT = 2.0
# Up to 4.7 this share of the acceleration stays free for what lies across the wanted velocity
# (CORNER_ACCELERATION_RATIO, control.h).
CORNER_SHARE = 1.0 / sqrt(2.0)
# AC_AttitudeControl.cpp: the least time constants of input_shaping_angle, up to 4.7, and of 4.8's
# attitude_command_model (ten loops at 400 Hz), and that one's acceleration where none is set.
LEAST_INPUT_S = 0.01
LEAST_COMMAND_S = 0.025
FASTEST_TURN_RPS2 = radians(1800.0)
# Up to 4.7 a position is approached with half the gain and half the acceleration (control.cpp).
APPROACH_SHARE = 0.5


def clamp(value: float, low: float, high: float) -> float:
    """The value, held between low and high."""
    return low if value < low else high if value > high else value


def limit_length(x: float, y: float, longest: float) -> tuple[float, float]:
    """The vector (x, y), shortened to the given length if it is longer."""
    squared = x * x + y * y
    if squared <= longest * longest:
        return x, y
    scale = longest / sqrt(squared)
    return x * scale, y * scale


def closing_rate(error: float, rate: float, gain: float, slope_limit: float) -> float:
    """Rate of correction that looks ahead: less by what the closing speed is about to use up.

    `rate` is the present rate towards the target (error's own rate of change, negated).
    ArduCopter 4.8 shapes so.
    """
    wanted = sqrt_controller(error, gain, slope_limit)
    if wanted * rate <= 0.0:
        return wanted
    slope = gain if abs(error) <= slope_limit / (gain * gain) else slope_limit / abs(wanted)
    return wanted - slope * rate / gain


def limit_corner(
    north: float, east: float, speed_n: float, speed_e: float, longest: float
) -> tuple[float, float]:
    """Acceleration cut to `longest`: braking comes before turning, turning before speeding up."""
    north, east = limit_length(north, east, CORNER_PRE_LIMIT * longest)
    speed = sqrt(speed_n * speed_n + speed_e * speed_e)
    if speed <= 0.0:
        return limit_length(north, east, longest)
    along_n, along_e = speed_n / speed, speed_e / speed
    along = north * along_n + east * along_e
    across = east * along_n - north * along_e
    if along < 0.0:
        along = max(along, -longest)
        room = sqrt(max(0.0, longest * longest - along * along))
        across = clamp(across, -room, room)
    else:
        across = clamp(across, -longest, longest)
        along = min(along, sqrt(max(0.0, longest * longest - across * across)))
    return along * along_n - across * along_e, along * along_e + across * along_n


def limit_lean(
    north: float, east: float, speed_n: float, speed_e: float, longest: float
) -> tuple[float, float]:
    """Acceleration cut to what the lean angle allows: across the path first, then along it."""
    if north * north + east * east <= longest * longest:
        return north, east
    speed = sqrt(speed_n * speed_n + speed_e * speed_e)
    if speed <= 0.0:
        return limit_length(north, east, longest)
    along_n, along_e = speed_n / speed, speed_e / speed
    across = clamp(east * along_n - north * along_e, -longest, longest)
    room = sqrt(max(0.0, longest * longest - across * across))
    along = clamp(north * along_n + east * along_e, -room, room)
    return along * along_n - across * along_e, along * along_e + across * along_n


def limit_input(
    north: float, east: float, wanted_n: float, wanted_e: float, longest: float
) -> tuple[float, float]:
    """Acceleration cut to `longest`: along the wanted velocity, with a share left for across it."""
    speed = sqrt(wanted_n * wanted_n + wanted_e * wanted_e)
    if speed <= 0.0:
        return limit_length(north, east, longest)
    along_n, along_e = wanted_n / speed, wanted_e / speed
    along = north * along_n + east * along_e
    across = east * along_n - north * along_e
    if along * along <= across * across:
        return limit_length(north, east, longest)
    across = clamp(across, -CORNER_SHARE * longest, CORNER_SHARE * longest)
    room = sqrt(longest * longest - across * across)
    along = clamp(along, -room, room)
    return along * along_n - across * along_e, along * along_e + across * along_n


Approach = Callable[[float, float, float, float, float, float, float], tuple[float, float]]
Demand = Callable[[float, float, float, float, float, float], tuple[float, float]]
Axis = Callable[[float, float, float, float, float, float, float], float]
Turn = Callable[[float, float, float, float, float, float, float, float], tuple[float, float]]


def predictive_approach(
    north: float,
    east: float,
    passing_n: float,
    passing_e: float,
    fastest: float,
    limit: float,
    jerk: float,
) -> tuple[float, float]:
    """Velocity that corrects a horizontal position error (`north`, `east`), m/s.

    `passing_*`: desired velocity now, less that of the point aimed at (m/s); `fastest`: limit of
    the correction, 0 is none. First half of shape_pos_vel_accel_xy of 4.8.
    """
    distance = sqrt(north * north + east * east)
    if distance <= 0.0:
        return 0.0, 0.0
    closing = (passing_n * north + passing_e * east) / distance
    speed = closing_rate(distance, closing, jerk / limit, limit)
    if fastest > 0.0:
        speed = clamp(speed, -fastest, fastest)
    return north / distance * speed, east / distance * speed


def predictive_demand(
    vn: float, ve: float, flown_n: float, flown_e: float, limit: float, jerk: float
) -> tuple[float, float]:
    """Acceleration towards the velocity of an approach: second half of the same, of 4.8.

    `flown_*`: desired velocity now. The jerk limit comes after.
    """
    gain = jerk / limit
    north, east = (vn - flown_n) * gain, (ve - flown_e) * gain
    return limit_corner(north, east, flown_n, flown_e, limit)


def predictive_speed(
    vn: float, ve: float, flown_n: float, flown_e: float, limit: float, jerk: float
) -> tuple[float, float]:
    """Acceleration towards a commanded velocity: shape_vel_accel_xy of 4.8."""
    north, east = _speed_correction(vn - flown_n, ve - flown_e, limit, jerk)
    return limit_corner(north, east, flown_n, flown_e, limit)


def predictive_axis(
    error: float,
    speed: float,
    feed_forward: float,
    slowest: float,
    fastest: float,
    limit: float,
    jerk: float,
) -> float:
    """Acceleration demand of one axis for a position error (m), before the jerk limit.

    `speed` is the present target speed, `feed_forward` the speed of the point aimed at (m/s);
    the correction stays within `slowest` and `fastest`, of which 0 is no limit.
    shape_pos_vel_accel of 4.8.
    """
    gain = jerk / limit
    correction = closing_rate(error, speed - feed_forward, gain, limit)
    if slowest < 0.0:
        correction = max(correction, slowest)
    if fastest > 0.0:
        correction = min(correction, fastest)
    return clamp((feed_forward + correction - speed) * gain, -limit, limit)


def stepped_approach(
    north: float,
    east: float,
    passing_n: float,
    passing_e: float,
    fastest: float,
    limit: float,
    jerk: float,
) -> tuple[float, float]:
    """As `predictive_approach`, by ArduCopter up to 4.7, which looks at no closing speed.

    Half the gain and half the acceleration instead: that is why it trails a moving point by more.
    """
    distance = sqrt(north * north + east * east)
    if distance <= 0.0:
        return 0.0, 0.0
    speed = sqrt_controller(distance, APPROACH_SHARE * jerk / limit, APPROACH_SHARE * limit)
    if fastest > 0.0:
        speed = min(speed, fastest)
    return north / distance * speed, east / distance * speed


def stepped_speed(
    vn: float, ve: float, flown_n: float, flown_e: float, limit: float, jerk: float
) -> tuple[float, float]:
    """Acceleration towards a velocity: shape_vel_accel_xy up to 4.7, also after an approach."""
    north, east = _speed_correction(vn - flown_n, ve - flown_e, limit, jerk)
    return limit_input(north, east, vn, ve, limit)


def stepped_axis(
    error: float,
    speed: float,
    feed_forward: float,
    slowest: float,
    fastest: float,
    limit: float,
    jerk: float,
) -> float:
    """As `predictive_axis`, by ArduCopter up to 4.7 (shape_pos_vel_accel)."""
    correction = sqrt_controller(error, APPROACH_SHARE * jerk / limit, APPROACH_SHARE * limit)
    if slowest < 0.0 or fastest > 0.0:
        correction = clamp(correction, slowest, fastest)
    return axis_speed(feed_forward + correction - speed, limit, jerk)


def axis_speed(error: float, limit: float, jerk: float) -> float:
    """Acceleration demand of one axis for a speed error: shape_vel_accel of every generation."""
    return clamp(sqrt_controller(error, jerk / limit, jerk), -limit, limit)


def stepped_turn(
    error: float,
    rate: float,
    acceleration: float,
    feed_forward: float,
    fastest: float,
    limit: float,
    input_s: float,
    dt: float,
) -> tuple[float, float]:
    """Rate of an attitude target (rad/s) and its acceleration, a step on: up to 4.7.

    `error`: its way to the angle wanted, which turns at `feed_forward`; `rate`, `acceleration`: its
    own so far, within `fastest` and `limit`; `input_s`: time constant. input_shaping_angle.
    """
    gain = 1.0 / max(input_s, LEAST_INPUT_S)
    wanted = clamp(feed_forward + sqrt_controller(error, gain, limit), -fastest, fastest)
    return rate + clamp(wanted - rate, -limit * dt, limit * dt), 0.0


def predictive_turn(
    error: float,
    rate: float,
    acceleration: float,
    feed_forward: float,
    fastest: float,
    limit: float,
    input_s: float,
    dt: float,
) -> tuple[float, float]:
    """The same of 4.8 (attitude_command_model): its jerk is limited, too."""
    limit = min(limit, FASTEST_TURN_RPS2)
    gain = 1.0 / max(input_s, LEAST_COMMAND_S)
    correction = closing_rate(error, rate - feed_forward, gain, limit)
    wanted = clamp(feed_forward + clamp(correction, -fastest, fastest), -fastest, fastest)
    most = limit * gain * dt
    acceleration += clamp(clamp((wanted - rate) * gain, -limit, limit) - acceleration, -most, most)
    return rate + acceleration * dt, acceleration


def _speed_correction(north: float, east: float, limit: float, jerk: float) -> tuple[float, float]:
    error = sqrt(north * north + east * east)
    if error <= 0.0:
        return 0.0, 0.0
    scale = sqrt_controller(error, jerk / limit, jerk) / error
    return north * scale, east * scale


@dataclass(frozen=True, slots=True)
class ShapingLaw:
    """How one line of ArduCopter turns a target into a demanded acceleration."""

    approach: Approach
    demand: Demand  # towards the velocity of an approach
    speed: Demand  # towards a commanded velocity
    axis: Axis
    turn: Turn  # of lean and heading


STEPPED = ShapingLaw(stepped_approach, stepped_speed, stepped_speed, stepped_axis, stepped_turn)
PREDICTIVE = ShapingLaw(
    predictive_approach, predictive_demand, predictive_speed, predictive_axis, predictive_turn
)
