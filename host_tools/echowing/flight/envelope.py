"""The envelope: what may be flown, so that vehicles are certain to stay apart. Pure.

For each other vehicle near by the envelope works out the distance that is certain, whatever the
errors of receivers and radios and whatever that vehicle does meanwhile, and the closing speed from
which this vehicle still stops in time. Each of these limits is a wall in the plane of velocities:
beyond it lie those that close too fast. What is flown is the velocity nearest to the plan's that no
wall forbids; if all are forbidden, the one whose greatest breach is least. Both are found exactly,
near the plan if there is one: it is changed by little more than each vehicle by itself calls for.
Between two that come from both sides what neither forbids may lie far out aside: nobody is sent
there who need not. So the envelope bends a plan that leads past a vehicle, slows one that leads at
it, and backs away from a vehicle that comes too near: it never stands still while another comes
nearer. Two vehicles in each other's way would wait for each other; so each passes the other on its
own right, as ships do.

Height counts as distance, not as a way out. Distances are taken in space: vehicles at two heights
may come nearer on the map. Closing speeds are level ones: the distance in space shrinks more
slowly. The vertical speed stays the plan's, and no wall brakes it: ArduCopter climbs with 2.5 m/s,
sinks with 1.5 m/s and changes that by 1 m/s2 (WP_SPD_UP, WP_SPD_DN, WP_ACC_Z), less than half of
what the level way out has.

The applet stops by the same rule (`guard.stoppable_mps` in `lua/echowing.lua`);
`tests/flight/envelope.toml` holds for both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from echowing.flight.half_planes import (
    SAME_MPS,
    Level,
    Wall,
    breaking_least,
    nearest,
    short_of_mps,
)
from echowing.geo import Ned

# What is promised between two vehicles' centres: two X8s are 0.5 m across (thesis Table 3).
LEAST_M = 1.0
# Standard deviations that are taken off a distance: one error in 160 is larger.
SURE_SIGMAS = 2.5
# What the other may do meanwhile: ArduCopter's default acceleration (WP_ACC).
OTHERS_MPS2 = 2.5
# Below LEAST_M: the retreat speed for each missing metre, and the fastest retreat.
RETREAT_PER_S, RETREAT_MOST_MPS = 1.5, 3.0
# So much too fast, a vehicle spends all its lean on the way out.
URGENT_MPS = 1.0
# The fastest correction that is reckoned with: WPNAV_SPEED's default up to 4.7.
FASTEST_MPS = 5.0
# What two walls up to 135 degrees apart leave is no further from the plan than this times what each
# calls for.
CORNER = math.sqrt(2.0)
# The plan as it is.
NO_CHANGE = (0.0, 0.0)


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
    does not; led: by the same tool; makes_room: that keeps it away from here too; stops_mps2: how
    hard it brakes then; watched: the sonar of this one looks at it.
    """

    name: str
    from_it_m: Ned
    velocity_mps: Ned
    nearer_m: float
    age_s: float
    in_the_way: bool = False
    brakes_mps2: float = 0.0
    led: bool = False
    makes_room: bool = False
    stops_mps2: float = OTHERS_MPS2
    watched: bool = False


def is_in_the_way(to_it_m: Ned, to_goal_m: Ned) -> bool:
    """Whether the way to a goal leads beyond another vehicle; both as seen from here, NED."""
    along_m2 = to_it_m[0] * to_goal_m[0] + to_it_m[1] * to_goal_m[1]
    return 0.0 < along_m2 < to_goal_m[0] ** 2 + to_goal_m[1] ** 2


def strays_m(age_s: float) -> float:
    """How far another vehicle may be from where a report of that age, carried on, has it."""
    return 0.5 * OTHERS_MPS2 * age_s * age_s


def certain_distance_m(other: Other) -> float:
    """The distance that is left in the worst case of all that is not known."""
    return math.hypot(*other.from_it_m) - other.nearer_m - strays_m(other.age_s)


def closing_limit_mps(
    certain_m: float,
    answer: Answer,
    least_m: float = LEAST_M,
    brakes_mps2: float = 0.0,
    retreat_per_s: float = RETREAT_PER_S,
) -> float:
    """The closing speed that is allowed at this distance; negative: fly away from the other.

    The root of dead u + a dead^2 / 2 + (u + a dead)^2 / 2 (b - a) = room: the distance lost until
    this vehicle brakes (b), while the other brakes already (a), and then until both are equally
    fast. If this vehicle brakes no harder than the other (b <= a), there is no such root: the other
    is taken to keep its speed, and the slot is far enough away (`handling.least_slot_m`).
    """
    room_m = certain_m - least_m
    retreat_mps = retreat_per_s * min(0.0, room_m)
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

    own_mps: its velocity now, NED. Closing speed above the limit is braked in addition, but not for
    others that are led: in a line each would fly back faster than the one before. Who is in the way
    counts as passed: the plan is turned right first. Where nothing near the plan fits, the others
    that make room count as doing so.
    """
    walls = [_wall(other, answer, least_m, own_mps) for other in others]
    short_mps = [short_of_mps(wanted_mps, wall) for wall in walls]
    worst = max(range(len(others)), key=short_mps.__getitem__, default=None)
    if worst is None or short_mps[worst] <= 0.0:
        return wanted_mps, None
    aim = wanted_mps[0], wanted_mps[1]
    for wall, other, mps in zip(walls, others, short_mps, strict=True):
        if mps > 0.0 and other.in_the_way:
            aim = _turned_right(aim, wall)
    around = _around(aim, walls)
    calls_for_mps = [SAME_MPS + max(0.0, short) for _, _, short in around]
    far_mps = max(FASTEST_MPS, *calls_for_mps)
    near_mps = min(far_mps, CORNER * sum(calls_for_mps))
    change = nearest(NO_CHANGE, around, near_mps)
    if change is None:
        yielding = [_wall(*_yielding(one, answer), least_m, own_mps) for one in others]
        around = _around(aim, yielding)
        change = nearest(NO_CHANGE, around, near_mps) or nearest(NO_CHANGE, around, far_mps)
    change = change or breaking_least(around, far_mps, around[worst])
    return (aim[0] + change[0], aim[1] + change[1], wanted_mps[2]), others[worst]


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
    if other.in_the_way or short_of_mps(own_mps, wall) < URGENT_MPS:
        return None
    change_mps = (flown_mps[0] - own_mps[0]) * north + (flown_mps[1] - own_mps[1]) * east
    straight = own_mps[0] + change_mps * north, own_mps[1] + change_mps * east, flown_mps[2]
    walls = (_wall(each, answer, least_m, own_mps) for each in others)
    if any(
        short_of_mps(straight, each) > max(0.0, short_of_mps(flown_mps, each)) + SAME_MPS
        for each in walls
    ):
        return None
    return straight


def _wall(other: Other, answer: Answer, least_m: float, own_mps: Ned | None) -> Wall:
    """The least speed away from another, less what rounding may take off it."""
    north, east, _ = other.from_it_m
    level_m = math.hypot(north, east)
    # Straight above or below each other: any direction leads away.
    north, east = (north / level_m, east / level_m) if level_m > 0.01 else (1.0, 0.0)
    its_mps = other.velocity_mps[0] * north + other.velocity_mps[1] * east
    certain_m = certain_distance_m(other)
    # Who is known by the tool alone is answered a second late: faster than that, two would swing.
    per_s = RETREAT_PER_S / 2.0 if other.led and not other.watched else RETREAT_PER_S
    limit_mps = closing_limit_mps(certain_m, answer, least_m, other.brakes_mps2, per_s)
    least_mps = its_mps - limit_mps - SAME_MPS
    if own_mps is None or other.led:
        return north, east, least_mps
    closing_mps = its_mps - own_mps[0] * north - own_mps[1] * east
    too_fast_mps = max(0.0, closing_mps - max(0.0, limit_mps))
    return north, east, least_mps + min(RETREAT_MOST_MPS, too_fast_mps)


def _turned_right(velocity: Level, wall: Wall) -> Level:
    """Fly the approach speed that a wall takes off to the right, past the other."""
    north, east, _ = wall
    closing_mps = max(0.0, -(velocity[0] * north + velocity[1] * east))
    aside_mps = min(closing_mps, max(0.0, short_of_mps(velocity, wall)))
    return velocity[0] + aside_mps * east, velocity[1] - aside_mps * north


def _around(aim: Level, walls: Sequence[Wall]) -> list[Wall]:
    """The walls in the plane of changes of a velocity."""
    return [(wall[0], wall[1], short_of_mps(aim, wall)) for wall in walls]


def _yielding(other: Other, answer: Answer) -> tuple[Other, Answer]:
    """As it counts where nothing fits, and both vehicles' answer together.

    Of one that makes room itself one standard deviation at most counts against a way out.
    """
    if not other.makes_room:
        return other, answer
    both = replace(answer, decel_mps2=answer.decel_mps2 + other.stops_mps2)
    return replace(other, nearer_m=other.nearer_m / SURE_SIGMAS, age_s=0.0), both
