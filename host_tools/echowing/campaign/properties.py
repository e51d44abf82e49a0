"""What must hold in every flight: each property is a pure function over the flight's record.

A property returns what broke it, the worst first where that can be ranked; an empty list if it
held. It makes exceptions only by a bound that it works out from the record.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from echowing.analysis.flight import Floats
from echowing.analysis.metrics import approach_s, metrics
from echowing.campaign.promises import broken_promises
from echowing.campaign.record import Bools, FlightRecord
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import (
    OTHERS_MPS2,
    RETREAT_MOST_MPS,
    SURE_SIGMAS,
    Answer,
    closing_limit_mps,
)
from echowing.flight.handling import reaction_s
from echowing.flight.lowest import LOWEST_M
from echowing.mavlink.vehicle_limits import INPUT_TIME
from echowing.sim.flight import SAMPLE_S
from echowing.sim.scenario import Scenario
from echowing.sim.vehicle.modes import GUIDED

# README's promise between any two vehicles.
LEAST_M = 1.0
# So long after data has become stale (guidance.stale_age_s, ECHO_STREAM_T) all stand.
STOPS_WITHIN_S = 2.0
# A held copter follows its receiver's wandering and the gusts: measured on a hovering leader, at
# most 0.23 m/s in calm and 0.1 m/s more for each 4 m/s of wind; twice that is motion.
STANDS_MPS, STANDS_PER_WIND = 0.5, 0.05
# A receiver that wanders by so much within so long, or steps: its vehicle flies after it at half a
# metre a second and more, and swings.
WANDERS_M, FOLLOWS_S = 0.8, 4.0
# A vehicle that flies away from another nearer than this makes room, whatever is stale: between
# followers the distance that the envelope keeps where no sonar ranges, from the leader its slot's
# radius; and half a metre more.
BETWEEN_FOLLOWERS_M = LEAST_M + SURE_SIGMAS * UNRANGED_SIGMA_M
MAKING_ROOM_M = 0.5
# In wind: a vehicle that leans so far has nothing left to brake with (30 degrees are its limit). It
# is the wind where it leans so much on the average, too, which leaves 2.1 of 5.7 m/s2: a retreat or
# a stop takes all the lean for a second, and is no excuse.
ALL_LEAN_RAD, BLOWN_WIND_MPS, BLOWN_S = math.radians(28.5), 4.0, 3.0
WIND_LEAN_RAD, WIND_LEAN_S = math.radians(20.0), 10.0
# One that has just taken off has leant since then.
IN_THE_AIR_M = 1.0
# A jump of its own receiver moves a vehicle, held or not: so long until the tool is sure of it.
JUMP_KNOWN_S = 2.0
# And so long until its autopilot has flown it.
FLOWN_S = 5.0
# Two receivers that were further off than is allowed for, up to so long before.
MISLED_S = 3.0
# Faults at whose beginning and end a receiver moves its vehicle's position.
_RECEIVERS = {"gps_jump", "gps_lost"}
# A reading this near to the leader's distance is the leader's.
RANGES_IT_M = 0.5
# The leader may have passed up to so many samples before the two vehicles were nearest.
PASSES = 10
# From a change of the mode to the pilot's value: the applet's period and the handing back.
HANDED_BACK_S = 0.5
# A vehicle that a point has reached within this time is led; else its pilot takes off in Guided.
POINT_ACTS_S = 1.0
# ArduCopter's Guided goes on flying a velocity for so long (GUID_TIMEOUT).
GUIDED_TIMEOUT_S = 3.0
# A leader heard and ranged, with nothing wrong: README's mean error is 0.12 m over fifty flights.
MEAN_ERROR_M = 0.5
# A mean over less than this after the approach says little.
JUDGED_S = 20.0
# Nothing is wrong with a flight up to these limits: README's headline was flown with them.
CALM_SPEED_MPS, CALM_LOSS, CALM_LATENCY_S = 2.0, 0.05, 0.5


@dataclass(frozen=True)
class Broken:
    """A property that did not hold: when, on which vehicle, by how much, and in words."""

    name: str
    time_s: float
    vehicle: int
    value: float
    text: str


Property = Callable[[FlightRecord], list[Broken]]


def separation(record: FlightRecord) -> list[Broken]:
    """Any two vehicles are at least LEAST_M apart, or nothing could have kept them so."""
    broken = []
    for number, (a, b) in enumerate(record.pairs):
        least_m = record.least_m[:, number]
        promised_m = promised_apart_m(record, number)
        short = np.flatnonzero(least_m < promised_m)
        if not len(short):
            continue
        sample = int(short[np.argmin(least_m[short])])
        bound_m = retreat_bound_m(record, sample, b) if a == 0 else math.inf
        if bound_m < promised_m[sample]:
            continue
        name = "the leader" if a == 0 else f"follower {a + 1}"
        blown = _blown(record, sample, a) or _blown(record, sample, b)
        kind = MISLED if _misled(record, sample, a, b) else "separation"
        broken.append(
            Broken(
                BLOWN if blown else kind,
                float(record.time_s[sample]),
                b + 1,
                float(least_m[sample]),
                f"follower {b + 1} came to {least_m[sample]:.2f} m of {name}",
            )
        )
    return sorted(broken, key=lambda one: one.value)


def promised_apart_m(record: FlightRecord, number: int) -> Floats:
    """The distance that a pair (by its number) is promised, sample by sample, (n,).

    Where pilots fly both of them, or the one that follows the leader, nothing is promised, nor
    until Guided can have answered. Then the distance that the pilots left must not shrink, until
    they are LEAST_M apart again.
    """
    least_m, followers = record.least_m[:, number], [one for one in record.pairs[number] if one]
    answers = [_lasted(record.guided[:, one - 1], Answer().dead_s) for one in followers]
    # A flight that begins in Guided: the record does not show what it has answered before.
    begins = [np.logical_and.accumulate(record.guided[:, one - 1]) for one in followers]
    led = np.logical_or.reduce([*answers, *begins])
    promised_m, left_m = np.full(len(least_m), -math.inf), LEAST_M
    for at, distance_m in enumerate(least_m.tolist()):
        if not led[at]:
            left_m = min(LEAST_M, distance_m)
        else:
            promised_m[at] = left_m
            left_m = LEAST_M if distance_m >= LEAST_M else left_m
    return promised_m


def _blown(record: FlightRecord, sample: int, vehicle: int) -> bool:
    """Whether the wind had just taken all the lean that a vehicle has."""
    if record.scenario.wind.speed_mps < BLOWN_WIND_MPS:
        return False
    flies = record.height_m[: sample + 1, vehicle] > IN_THE_AIR_M
    lean_rad = record.lean_rad[: sample + 1, vehicle][flies][-round(WIND_LEAN_S / SAMPLE_S) :]
    at_limit = (lean_rad[-round(BLOWN_S / SAMPLE_S) - 1 :] >= ALL_LEAN_RAD).any()
    return bool(at_limit and lean_rad.mean() >= WIND_LEAN_RAD)


def _misled(record: FlightRecord, sample: int, a: int, b: int) -> bool:
    """Whether two receivers have just shown a pair further apart than the envelope allows for.

    A receiver that a fault has moved is no excuse where the tool runs, which sees its jump; else
    its autopilot flies it. Nor is one that a sonar could correct: a leader that was ranged
    meanwhile.
    """
    now_s = record.time_s[sample]
    if any(one.kind in _RECEIVERS and one.at_s <= now_s for one in record.scenario.fault):
        lately = slice(max(0, sample - round(FLOWN_S / SAMPLE_S)), sample + 1)
        jumped = any(_jumps(record, one - 1)[lately].any() for one in (a, b) if one)
        return bool(jumped and not record.tool[lately].any())
    recent = range(max(0, sample - round(MISLED_S / SAMPLE_S)), sample + 1)
    if a == 0 and any(_ranges_the_leader(record, at, b) for at in recent):
        return False
    apart_m = record.position_ned_m[recent, b] - record.position_ned_m[recent, a]
    shown_m = apart_m.copy()
    shown_m[:, :2] += record.receiver_error_m[recent, b] - record.receiver_error_m[recent, a]
    further_m = np.linalg.norm(shown_m, axis=1) - np.linalg.norm(apart_m, axis=1)
    return bool(further_m.max() > SURE_SIGMAS * UNRANGED_SIGMA_M)


def retreat_bound_m(record: FlightRecord, sample: int, follower: int) -> float:
    """What a perfect retreat would have left of the distance to the leader; `follower`: its index.

    The leader's approach is what it flew towards the follower's place, sample by sample, without a
    break before `sample`. Until a report of the approach, or the sonar's second reading of it, has
    had the time to act, the follower's flown velocity counts, but closing no faster than it can
    stop within the promise from where the approach began. Then its retreat begins, no faster than
    the core's. While its pilot flies it, all that it flies counts.
    """
    apart = record.position_ned_m[:, follower] - record.position_ned_m[:, 0]
    distance_m = np.linalg.norm(apart, axis=1)
    towards = np.sum(record.velocity_ned_mps[:, 0] * apart, axis=1) / np.maximum(distance_m, 1e-6)
    own = np.sum(record.velocity_ned_mps[:, follower] * apart, axis=1) / np.maximum(
        distance_m, 1e-6
    )
    # The leader may have passed already when the two were nearest.
    last = next(
        (at for at in range(sample, max(0, sample - PASSES), -1) if towards[at] > STANDS_MPS), None
    )
    if last is None:
        return math.inf  # the leader did not fly at it
    first = last
    while first > 0 and towards[first - 1] > STANDS_MPS:
        first -= 1
    if distance_m[first] < LEAST_M:
        return math.inf  # the follower had come too near before, and only then met its leader
    known = _known_from(record, first, follower) + round(Answer().dead_s / SAMPLE_S)
    led = record.guided[:, follower - 1]
    answers = _lasted(led, Answer().dead_s)
    left_m = float(distance_m[first])
    closing_mps = closing_limit_mps(left_m, Answer(), LEAST_M)
    away_mps, bound_m = 0.0, left_m
    for at in range(first, last + 1):
        if not led[at]:
            away_mps = float(own[at])
        elif at < known or not answers[at]:
            away_mps = max(float(own[at]), -closing_mps)
        else:
            away_mps = min(RETREAT_MOST_MPS, away_mps + OTHERS_MPS2 * SAMPLE_S)
        left_m += (away_mps - float(towards[at])) * SAMPLE_S
        bound_m = min(bound_m, left_m)
    return bound_m


def _known_from(record: FlightRecord, first: int, follower: int) -> int:
    """The first sample at which an approach that began at `first` can be known."""
    began_s = record.time_s[first]
    for at in range(first, len(record.time_s)):
        reported = record.tool[at] and record.time_s[at] - record.leader_age_s[at] >= began_s
        taken = record.stream_age_s[at, follower - 1] < 1.0
        twice = _ranges_the_leader(record, at, follower) and _ranges_the_leader(
            record, at - 1, follower
        )
        ranged = at > first and record.applet[at, follower - 1] and twice
        if (reported and taken) or ranged:
            return at
    return len(record.time_s)


def _ranges_the_leader(record: FlightRecord, at: int, follower: int) -> bool:
    """Whether the sonar's newest reading is the leader's, and no other vehicle's."""
    apart = record.position_ned_m[at, follower] - record.position_ned_m[at, 0]
    reads_m = float(np.linalg.norm(apart)) - record.scenario.sonar_belief.inset_m
    return bool(abs(record.sonar_m[at, follower - 1] - reads_m) < RANGES_IT_M)


def stopped(record: FlightRecord) -> list[Broken]:
    """A follower whose data are stale, or whose stop was ordered, stands soon after."""
    wind_mps = record.scenario.wind.speed_mps
    stands_mps = STANDS_MPS + STANDS_PER_WIND * wind_mps
    broken = []
    for number in range(record.follower_count):
        must = must_stand(record, number)
        moving = record.speed_over_ground_mps[:, number + 1] > stands_mps
        at = _lasting(must & moving, 0.5)
        if at is None:
            continue
        speed_mps = float(record.speed_over_ground_mps[at, number + 1])
        broken.append(
            Broken(
                BLOWN_ON if _blown(record, at, number + 1) else "stopped",
                float(record.time_s[at]),
                number + 2,
                speed_mps,
                f"follower {number + 2} moves at {speed_mps:.1f} m/s, its data stale or its stop "
                f"ordered for {STOPS_WITHIN_S:g} s or longer",
            )
        )
    return broken


def _wanders(record: FlightRecord, vehicle: int) -> Bools:
    """Whether a vehicle's receiver has just wandered so fast that to follow it is motion, (n,)."""
    error_m = record.receiver_error_m[:, vehicle]
    span = round(FOLLOWS_S / SAMPLE_S)
    moved_m = np.zeros(len(error_m))
    for back in range(1, span + 1):  # a step and back counts as both
        off_m = np.linalg.norm(error_m[back:] - error_m[:-back], axis=1)
        moved_m[back:] = np.maximum(moved_m[back:], off_m)
    return np.asarray(moved_m > WANDERS_M)


def must_stand(record: FlightRecord, number: int) -> Bools:
    """When a follower (index from 0) has to stand, (n,)."""
    stale_s = record.scenario.guidance.stale_age_s or math.inf
    silence_s = record.scenario.applet.get("ECHO_STREAM_T", 1.0)
    streams = np.isfinite(record.stream_age_s[:, number])
    # Without the applet only Guided's own time-out detects a lost stream on board.
    silence = np.where(record.applet[:, number], silence_s, silence_s + GUIDED_TIMEOUT_S)
    stale = record.tool & (record.leader_age_s > stale_s)
    silent = streams & (record.stream_age_s[:, number] > silence)
    switched = record.switched[:, number] & record.tool
    # Neither is sent any points: each holds its place by itself.
    left = silent | switched
    reason = (stale & streams) | (left & ~_elsewhere(record, number, left))
    # One that has made room for another is given the time to stop again.
    reason &= record.guided[:, number] & ~_making_room(record, number + 1)
    # So is one whose own receiver has jumped: its autopilot flies that before anybody knows of it.
    reason &= ~_jumps(record, number) & ~_wanders(record, number + 1)
    reason[: round(STOPS_WITHIN_S / SAMPLE_S)] = False
    return _could_stop(reason, record.speed_over_ground_mps[:, number + 1])


def _could_stop(reason: Bools, speed_mps: Floats) -> Bools:
    """Where a reason to stop has held long enough for the speed at which it came, (n,)."""
    could = np.zeros(len(reason), dtype=np.bool_)
    began = None
    for at, holds in enumerate(reason.tolist()):
        if not holds:
            began = None
            continue
        began = at if began is None else began
        brakes_s = float(speed_mps[began]) / OTHERS_MPS2
        within_s = max(STOPS_WITHIN_S, reaction_s(INPUT_TIME.usual) + brakes_s)
        could[at] = at - began >= round(within_s / SAMPLE_S)
    return could


def _elsewhere(record: FlightRecord, number: int, left: Bools) -> Bools:
    """When a follower's receiver has jumped since it was left to itself, (n,).

    It then holds its place by its receiver alone, and flies to where that puts it now.
    """
    jumps_s = _jumps_s(record, number)
    elsewhere = np.zeros(len(left), dtype=np.bool_)
    for at in range(1, len(left)):
        before_s, now_s = record.time_s[at - 1], record.time_s[at]
        jumped = any(before_s < edge_s <= now_s for edge_s in jumps_s)
        elsewhere[at] = left[at] and (elsewhere[at - 1] or jumped)
    return elsewhere


def _jumps(record: FlightRecord, number: int) -> Bools:
    """When a follower's receiver has jumped so lately that the tool cannot be sure of it, (n,)."""
    since_s = [record.time_s - edge_s for edge_s in _jumps_s(record, number)]
    lately = [(one > 0.0) & (one <= JUMP_KNOWN_S) for one in since_s]
    return np.logical_or.reduce(lately) if lately else np.zeros(len(record.time_s), dtype=np.bool_)


def _jumps_s(record: FlightRecord, number: int) -> list[float]:
    """When a follower's receiver jumps, and back."""
    return [
        edge_s
        for fault in record.scenario.fault
        if fault.kind in _RECEIVERS and fault.vehicle == number + 2
        for edge_s in (fault.at_s, fault.ends_s)
    ]


def _making_room(record: FlightRecord, vehicle: int) -> Bools:
    """When a vehicle flies away from another that is nearer than it should be, (n,)."""
    room = np.zeros(len(record.time_s), dtype=np.bool_)
    slot = record.scenario.formation.slots[vehicle - 1]
    for other in range(record.position_ned_m.shape[1]):
        if other == vehicle:
            continue
        apart = record.position_ned_m[:, vehicle] - record.position_ned_m[:, other]
        distance_m = np.linalg.norm(apart, axis=1)
        leaves = np.sum(record.velocity_ned_mps[:, vehicle] * apart, axis=1) > 0.0
        watched = other == (slot.behind or 0)
        near_m = MAKING_ROOM_M + (slot.radius_m if watched else BETWEEN_FOLLOWERS_M)
        room |= leaves & (distance_m < near_m)
    return room


def pilots_word(record: FlightRecord) -> list[Broken]:
    """No point goes to a vehicle that has reported that it is not in Guided, or not in the air."""
    for point in record.points:
        if point.known_mode == GUIDED and point.known_flying:
            continue
        where = "on the ground" if point.known_mode == GUIDED else f"in mode {point.known_mode}"
        return [
            Broken(
                "pilots word",
                point.time_s,
                point.vehicle,
                float(point.known_mode or -1),
                f"a point was sent to follower {point.vehicle}, which had said that it was {where}",
            )
        ]
    return []


def speed_handed_back(record: FlightRecord) -> list[Broken]:
    """Outside Guided the speed parameter is the pilot's, where the applet runs to restore it."""
    broken = []
    for number in range(record.follower_count):
        away = _lasted(
            record.applet[:, number] & (record.mode[:, number + 1] != GUIDED), HANDED_BACK_S
        )
        wrong = away & ~np.isclose(record.speed_mps[:, number], record.pilot_speed_mps, atol=1e-3)
        at = _lasting(wrong, 0.0)
        if at is not None:
            value = float(record.speed_mps[at, number])
            broken.append(
                Broken(
                    "speed handed back",
                    float(record.time_s[at]),
                    number + 2,
                    value,
                    f"follower {number + 2}: its speed parameter is {value:.2f} m/s outside "
                    f"Guided, and its pilot's is {record.pilot_speed_mps:.2f}",
                )
            )
    return broken


def not_too_low(record: FlightRecord) -> list[Broken]:
    """Never led lower than LOWEST_M above its home, unless its place is."""
    broken = []
    scenario = record.scenario
    for number, slot in enumerate(scenario.formation.slots):
        least_m = min(LOWEST_M, scenario.leader.altitude_m + slot.altitude_step_m)
        # Its height wanders in the wind by some decimetres.
        led = record.guided[:, number] & (record.stream_age_s[:, number] < POINT_ACTS_S)
        low = led & (record.height_m[:, number + 1] < least_m - 0.3)
        at = _lasting(low, 0.5)
        if at is not None:
            value = float(record.height_m[at, number + 1])
            broken.append(
                Broken(
                    "not too low",
                    float(record.time_s[at]),
                    number + 2,
                    value,
                    f"follower {number + 2} was led to {value:.1f} m above its home",
                )
            )
    return broken


def texts_said(record: FlightRecord) -> list[Broken]:
    """Every text that is promised for a fault was said (see `campaign.promises`)."""
    return [
        Broken("texts said", at_s, vehicle, 0.0, text)
        for at_s, vehicle, text in broken_promises(record)
    ]


def mean_error(record: FlightRecord) -> list[Broken]:
    """Where nothing was wrong and the sonar reaches the leader, the mean error is small."""
    if not nothing_wrong(record):
        return []
    broken = []
    for number, flight in enumerate(record.flights):
        slot = record.scenario.formation.slots[number]
        sonar = record.scenario.sonar_belief
        if slot.radius_m - sonar.inset_m >= sonar.reach_m or slot.altitude_step_m != 0.0:
            continue
        approached_s = approach_s(flight)
        if record.time_s[-1] - approached_s < JUDGED_S:
            continue
        value = metrics(flight, approached_s).mean_abs_error_m
        if value > MEAN_ERROR_M:
            broken.append(
                Broken(
                    "mean error",
                    float(record.time_s[-1]),
                    number + 2,
                    value,
                    f"follower {number + 2}: mean error {value:.2f} m, and nothing was wrong",
                )
            )
    return broken


def nothing_wrong(record: FlightRecord) -> bool:
    """No fault, and a flight of the kind that README's headline is made from."""
    scenario = record.scenario
    leader = scenario.radio.leader
    return (
        not scenario.fault
        and scenario.wind.speed_mps == 0.0
        and not scenario.follower.parameters
        and scenario.guidance_settings().feed_forward
        and scenario.leader.speed_mps <= CALM_SPEED_MPS
        and scenario.leader.path in ("rectangle", "circle", "figure-eight")
        and len(scenario.formation.slots) == 1
        and leader.frames_lost <= CALM_LOSS
        and scenario.radio.follower.byte_loss <= CALM_LOSS
        and scenario.wire == type(scenario.wire)()
        and not _is_worse_than_believed(scenario)
        and leader.latency_s + leader.jitter_s <= CALM_LATENCY_S
        and scenario.airframe == type(scenario.airframe)()
    )


def _is_worse_than_believed(scenario: Scenario) -> bool:
    """Whether sonars, receivers or heights are given worse than the product takes for granted."""
    given, file, gps = scenario.sonar, scenario.sonar_file, scenario.gps
    usual = type(gps)()
    no_less = (
        (given.heard_share, min(file.heard.least)),
        (given.beam_near_deg, file.beam.narrowest_deg[0]),
        (given.beam_far_deg, file.beam.narrowest_deg[-1]),
        (given.heard_to_m, file.foil_to_m[0]),
        (given.inset_m, file.inset_m[0]),
    )
    no_more = (
        (given.noise_m, file.noise_m[1]),
        (given.wild_share, file.wild_share[1] + file.late_share[1]),
        (given.late_share, file.late_share[1]),
        (given.inset_m, file.inset_m[1]),
        (given.deaf_share + given.tone_share, 0.0),
        (given.spread, 1.0),
        (gps.sigma_m, usual.sigma_m),
        (gps.vertical_sigma_m, usual.vertical_sigma_m),
        (gps.spread, usual.spread),
        (gps.step_m + gps.multipath_m, 0.0),
    )
    return any(value is not None and value < least for value, least in no_less) or any(
        value is not None and value > most for value, most in no_more
    )


# The same while the wind took all the lean: counted apart, as no control law can prevent it.
BLOWN, BLOWN_ON = "separation, blown", "stopped, blown"
# Or while two receivers that no sonar corrects disagreed by more than the envelope allows for.
MISLED = "separation, receivers"

# In the order of the report.
PROPERTIES: dict[str, Property] = {
    "separation": separation,
    "stopped": stopped,
    "pilots word": pilots_word,
    "speed handed back": speed_handed_back,
    "not too low": not_too_low,
    "texts said": texts_said,
    "mean error": mean_error,
}


def judge(record: FlightRecord, names: Sequence[str] = tuple(PROPERTIES)) -> list[Broken]:
    """All that is broken in a flight, of the properties named."""
    return [broken for name in names for broken in PROPERTIES[name](record)]


def _lasted(condition: Bools, seconds: float) -> Bools:
    """Where a condition has held for so long without a gap, (n,)."""
    need = round(seconds / SAMPLE_S)
    run, lasted = 0, np.zeros(len(condition), dtype=np.bool_)
    for at, holds in enumerate(condition.tolist()):
        run = run + 1 if holds else 0
        lasted[at] = run > need
    return lasted


def _lasting(condition: Bools, seconds: float) -> int | None:
    """The first sample at which a condition has held for so long."""
    found = np.flatnonzero(_lasted(condition, seconds))
    return int(found[0]) if len(found) else None
