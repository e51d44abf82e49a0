"""Kinematic shaping: how ArduPilot turns an error into a smooth demand.

The laws are those of libraries/AP_Math/control.cpp. Everything is a plain function of scalars,
because these run fifty times a simulated second and vehicle.
"""

from math import sqrt

# Before braking and cornering are weighed against each other the demand is cut to this many times
# the limit, so that a huge along-track demand does not hide the cross-track one (control.cpp).
CORNER_PRE_LIMIT = 2.0


def clamp(value: float, low: float, high: float) -> float:
    """The value, held between low and high."""
    return low if value < low else min(value, high)


def limit_length(x: float, y: float, longest: float) -> tuple[float, float]:
    """The vector (x, y), shortened to the given length if it is longer."""
    squared = x * x + y * y
    if squared <= longest * longest:
        return x, y
    scale = longest / sqrt(squared)
    return x * scale, y * scale


def sqrt_controller(error: float, gain: float, slope_limit: float) -> float:
    """Rate of correction for an error: proportional near zero, then a square root.

    The square root is what a constant deceleration of `slope_limit` allows. A `slope_limit` of 0
    is no limit.
    """
    if slope_limit <= 0.0:
        return error * gain
    linear = slope_limit / (gain * gain)
    if error > linear:
        return sqrt(2.0 * slope_limit * (error - 0.5 * linear))
    if error < -linear:
        return -sqrt(2.0 * slope_limit * (-error - 0.5 * linear))
    return error * gain


def inverse_sqrt_controller(rate: float, gain: float, slope_limit: float) -> float:
    """Error at which `sqrt_controller` gives this rate: also the distance a stop takes."""
    if slope_limit <= 0.0 or abs(rate) < slope_limit / gain:
        return rate / gain
    distance = 0.5 * slope_limit / (gain * gain) + 0.5 * rate * rate / slope_limit
    return distance if rate > 0.0 else -distance


def closing_rate(error: float, rate: float, gain: float, slope_limit: float) -> float:
    """Rate of correction that looks ahead: less by what the closing speed is about to use up.

    `rate` is the present rate towards the target (error's own rate of change, negated).
    ArduCopter 4.8 shapes so; it is why a streamed target is trailed by twice the distance of 4.6.
    """
    wanted = sqrt_controller(error, gain, slope_limit)
    if wanted * rate <= 0.0:
        return wanted
    slope = gain if abs(error) <= slope_limit / (gain * gain) else slope_limit / abs(wanted)
    return wanted - slope * rate / gain


def shape_axis(
    error: float,
    speed: float,
    feed_forward: float,
    slowest: float,
    fastest: float,
    acceleration_max: float,
    jerk_max: float,
) -> float:
    """Acceleration demand of one axis for a position error (m), before the jerk limit.

    `speed` is the present target speed, `feed_forward` the speed of the point aimed at (m/s);
    the correction stays within `slowest` and `fastest`, of which 0 is no limit.
    """
    gain = jerk_max / acceleration_max
    correction = closing_rate(error, speed - feed_forward, gain, acceleration_max)
    if slowest < 0.0:
        correction = max(correction, slowest)
    if fastest > 0.0:
        correction = min(correction, fastest)
    wanted = (feed_forward + correction - speed) * gain
    return clamp(wanted, -acceleration_max, acceleration_max)


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
