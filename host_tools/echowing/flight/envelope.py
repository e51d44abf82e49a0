"""The envelope: what may be flown, so that vehicles are certain to stay apart. Pure.

For each other vehicle near by the envelope works out the distance that is certain, whatever the
errors of receivers and radios and whatever that vehicle does meanwhile, and the closing speed from
which this vehicle still stops in time. It flies the velocity nearest to the plan's that closes on
nobody faster; if there is none, the one that leaves most room during the next second. So it bends a
plan that leads past a vehicle, slows one that leads at it, and backs away from a vehicle that comes
too near: it never stands still while another comes nearer. Two vehicles in each other's way would
wait for each other; so each passes the other on its own right, as ships do.

The applet stops by the same rule (`guard.stoppable_mps` in `lua/echowing.lua`);
`tests/flight/envelope.toml` holds for both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from echowing.geo import Ned

# What is promised between two vehicles' centres: two X8s are 0.5 m across (thesis Table 3).
LEAST_M = 1.0
# Standard deviations that are taken off a distance: one error in 160 is larger.
SURE_SIGMAS = 2.5
# What the other may do meanwhile: ArduCopter's default acceleration (WP_ACC).
OTHERS_MPS2 = 2.5
# Below LEAST_M: the retreat speed for each missing metre, and the fastest retreat.
RETREAT_PER_S, RETREAT_MOST_MPS = 1.5, 3.0
# A candidate is judged by the distance it leaves up to this time; their number round the compass.
LOOK_AHEAD_S = 1.0
CANDIDATES = 16
# So much too fast, a vehicle spends all its lean on the way out.
URGENT_MPS = 1.0
# Rounds of correction, one other after another: with two in the way they settle in a few.
ROUNDS = 4
SAME_MPS = 1e-6


@dataclass(frozen=True, slots=True)
class Answer:
    """How a vehicle answers: dead time from order to motion, and its deceleration then.

    The default deceleration is ArduCopter's own WP_ACC.
    """

    dead_s: float = 0.6
    decel_mps2: float = OTHERS_MPS2


@dataclass(frozen=True, slots=True)
class Other:
    """Another vehicle as this one sees it.

    name: for messages; from_it_m: from it to here, NED; velocity_mps: its, NED; nearer_m: by so
    much it may be nearer than that, one case in 160 left out; age_s: of its data when the order
    takes effect; in_the_way: the plan leads beyond it (see `is_in_the_way`), so it is passed;
    brakes_mps2: it may brake, turn round and come nearer at this acceleration from now on, 0: it
    does not; led: by the same tool, which
    keeps it away from here too.
    """

    name: str
    from_it_m: Ned
    velocity_mps: Ned
    nearer_m: float
    age_s: float
    in_the_way: bool = False
    brakes_mps2: float = 0.0
    led: bool = False


def is_in_the_way(to_it_m: Ned, to_goal_m: Ned) -> bool:
    """Whether the way to a goal leads beyond another vehicle; both as seen from here, NED."""
    along_m2 = to_it_m[0] * to_goal_m[0] + to_it_m[1] * to_goal_m[1]
    return 0.0 < along_m2 < to_goal_m[0] ** 2 + to_goal_m[1] ** 2


def certain_distance_m(other: Other) -> float:
    """The distance that is left in the worst case of all that is not known."""
    meanwhile_m = 0.5 * OTHERS_MPS2 * other.age_s * other.age_s
    return math.hypot(*other.from_it_m) - other.nearer_m - meanwhile_m


def closing_limit_mps(
    certain_m: float, answer: Answer, least_m: float = LEAST_M, brakes_mps2: float = 0.0
) -> float:
    """The closing speed that is allowed at this distance; negative: fly away from the other.

    The root of dead u + a dead^2 / 2 + (u + a dead)^2 / 2 (b - a) = room: the distance lost until
    this vehicle brakes (b), while the other brakes already (a), and then until both are equally
    fast. If this vehicle brakes no harder than the other (b <= a), there is no such root: the other
    is taken to keep its speed, and the slot is far enough away (`handling.least_slot_m`).
    """
    room_m = certain_m - least_m
    retreat_mps = RETREAT_PER_S * min(0.0, room_m)
    gains_mps2 = answer.decel_mps2 - brakes_mps2
    if gains_mps2 <= 0.0:
        brakes_mps2, gains_mps2 = 0.0, answer.decel_mps2
    unaware_mps, lag_mps = brakes_mps2 * answer.dead_s, answer.decel_mps2 * answer.dead_s
    lost_mps2 = unaware_mps * (unaware_mps + gains_mps2 * answer.dead_s)
    root_mps = math.sqrt(lag_mps * lag_mps - lost_mps2 + 2.0 * gains_mps2 * max(0.0, room_m))
    return max(-RETREAT_MOST_MPS, retreat_mps + root_mps - lag_mps)


def keep_apart(
    wanted_mps: Ned,
    others: Sequence[Other],
    answer: Answer,
    least_m: float = LEAST_M,
    own_mps: Ned | None = None,
) -> tuple[Ned, Other | None]:
    """The velocity to fly (NED), and the vehicle for which it differs from the wanted one.

    own_mps: its velocity now, NED. Closing speed above the limit is braked in addition.
    """
    walls = [_wall(other, answer, least_m, own_mps) for other in others]
    broken = [
        (wall, other) for wall, other in zip(walls, others, strict=True) if _off(wanted_mps, wall)
    ]
    if not broken:
        return wanted_mps, None
    flown = wanted_mps
    for wall, other in broken:
        if other.in_the_way:
            flown = _turned_right(flown, wall)
    for _ in range(ROUNDS):
        for wall in walls:
            flown = _pushed(flown, wall)
    if any(_off(flown, wall) < -0.05 for wall in walls):
        flown = _roomiest(flown, others)
    worst = min(broken, key=lambda pair: _off(wanted_mps, pair[0]))[1]
    return flown, worst


def straight_out(
    flown_mps: Ned,
    other: Other,
    others: Sequence[Other],
    answer: Answer,
    least_m: float,
    own_mps: Ned,
) -> Ned | None:
    """The way out (`flown_mps`, for `other`) without a change across it; None: it is not urgent.

    Lean is limited, and ArduCopter spends it across the way first (limit_accel_xy, AP_Math): on
    SITL 4.8 a follower that was also 0.6 m beside its slot braked with 4.2 m/s2 instead of 5.5.
    """
    north, east, _ = wall = _wall(other, answer, least_m, own_mps)
    if other.in_the_way or _off(own_mps, wall) > -URGENT_MPS:
        return None
    change_mps = (flown_mps[0] - own_mps[0]) * north + (flown_mps[1] - own_mps[1]) * east
    straight = own_mps[0] + change_mps * north, own_mps[1] + change_mps * east, flown_mps[2]
    walls = (_wall(each, answer, least_m, own_mps) for each in others)
    if any(_off(straight, each) < _off(flown_mps, each) - SAME_MPS for each in walls):
        return None
    return straight


# A wall in the space of velocities: the direction away from the other (horizontal unit vector), and
# the least speed along it.
_Wall = tuple[float, float, float]


def _wall(other: Other, answer: Answer, least_m: float, own_mps: Ned | None) -> _Wall:
    north, east, _ = other.from_it_m
    level_m = math.hypot(north, east)
    # Straight above or below each other: any direction leads away.
    north, east = (north / level_m, east / level_m) if level_m > 0.01 else (1.0, 0.0)
    its_mps = other.velocity_mps[0] * north + other.velocity_mps[1] * east
    certain_m = certain_distance_m(other)
    limit_mps = closing_limit_mps(certain_m, answer, least_m, other.brakes_mps2)
    if own_mps is None:
        return north, east, its_mps - limit_mps
    closing_mps = its_mps - own_mps[0] * north - own_mps[1] * east
    too_fast_mps = max(0.0, closing_mps - max(0.0, limit_mps))
    return north, east, its_mps - limit_mps + min(RETREAT_MOST_MPS, too_fast_mps)


def _off(velocity: Ned, wall: _Wall) -> float:
    """By how much a velocity falls short of a wall's speed (negative); 0: it does not."""
    speed_mps = velocity[0] * wall[0] + velocity[1] * wall[1]
    return min(0.0, speed_mps - wall[2] + SAME_MPS)


def _pushed(velocity: Ned, wall: _Wall) -> Ned:
    short_mps = -_off(velocity, wall)
    return velocity[0] + short_mps * wall[0], velocity[1] + short_mps * wall[1], velocity[2]


def _turned_right(velocity: Ned, wall: _Wall) -> Ned:
    """Fly the approach speed that a wall takes off to the right, past the other."""
    north, east, _ = wall
    closing_mps = max(0.0, -(velocity[0] * north + velocity[1] * east))
    aside_mps = min(closing_mps, -_off(velocity, wall))
    return velocity[0] + aside_mps * east, velocity[1] - aside_mps * north, velocity[2]


def _roomiest(tried: Ned, others: Sequence[Other]) -> Ned:
    """The candidate round the compass that leaves most of the certain distances."""
    speed_mps = max(1.0, min(RETREAT_MOST_MPS, math.hypot(tried[0], tried[1])))
    ways = [(0.0, 0.0), *(_compass(number, speed_mps) for number in range(CANDIDATES))]
    north, east = max(ways, key=lambda way: _room(others, way))
    return north, east, tried[2]


def _room(others: Sequence[Other], way: tuple[float, float]) -> tuple[float, float]:
    """What a velocity (north, east) leaves of the certain distances: on the way, and at its end.

    The end alone is not enough: beyond a vehicle that is flown through there is room, too.
    """
    left = [_left_m(other, way) for other in others]
    return min(on_the_way for on_the_way, _ in left), min(at_its_end for _, at_its_end in left)


def _compass(number: int, speed_mps: float) -> tuple[float, float]:
    bearing_rad = 2.0 * math.pi * number / CANDIDATES
    return speed_mps * math.cos(bearing_rad), speed_mps * math.sin(bearing_rad)


def _left_m(other: Other, way: tuple[float, float]) -> tuple[float, float]:
    """The least certain distance within `LOOK_AHEAD_S`, for a velocity, and the one at its end."""
    north, east, down = other.from_it_m
    gone_north = (way[0] - other.velocity_mps[0]) * LOOK_AHEAD_S
    gone_east = (way[1] - other.velocity_mps[1]) * LOOK_AHEAD_S
    gone_m2 = max(1e-9, gone_north * gone_north + gone_east * gone_east)
    nearest_at = max(0.0, min(1.0, -(north * gone_north + east * gone_east) / gone_m2))
    lost_m = math.hypot(*other.from_it_m) - certain_distance_m(other)
    if other.led:
        # It makes room itself: at most one standard deviation counts against a way out.
        lost_m = min(lost_m, other.nearer_m / SURE_SIGMAS)
    nearest_m, end_m = (
        math.hypot(north + share * gone_north, east + share * gone_east, down) - lost_m
        for share in (nearest_at, 1.0)
    )
    return nearest_m, end_m
