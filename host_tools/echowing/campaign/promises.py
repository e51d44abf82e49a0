"""The texts that are promised for a fault, and which of them were not said.

Each promise says for one kind of fault which text is due, from whom, and by when. It applies if the
record shows that the fault could be noticed: the follower is led, the tool runs, the link works.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from echowing.campaign.record import Bools, FlightRecord
from echowing.sim.fault_section import LEADER, FaultSection
from echowing.sim.flight import SAMPLE_S

# Two lost packets of a bad link may delay a detection; rates are judged over 8 s.
SLACK_S = 2.0


@dataclass(frozen=True)
class Promise:
    """What is said (a regular expression) once a fault has lasted `after_s`, by tool or vehicle.

    needs_s: a shorter fault need not be noticed.
    """

    kind: str
    says: str
    by_vehicle: bool
    after_s: float
    needs_s: float


PROMISES = (
    Promise("outage", r"leader is stale, holding", False, 1.0, 4.0),
    Promise("outage", r"follower {id}: no report for", False, 2.0, 4.0),
    Promise("tool_killed", r"stream lost, holding here", True, 1.5, 3.0),
    Promise("tool_stopped", r"follower {id}: the tool ends, holding", False, 0.5, 0.0),
    Promise("pilot_takes_over", r"follower {id}: left Guided for", False, 1.5, 3.0),
    Promise("pilot_takes_over", r"handed back", True, 0.5, 1.0),
    Promise("stop_switch", r"follower {id}: stop switch, holding", False, 1.0, 2.0),
    Promise("coprocessor_off", r"no sonar data", True, 1.5, 3.0),
    Promise("gps_lost", r"{who} has no GPS fix, holding", False, 1.5, 3.0),
)


def broken_promises(record: FlightRecord) -> Iterator[tuple[float, int, str]]:
    """When and of which vehicle something promised was not said, in words."""
    for fault in record.scenario.fault:
        for promise in PROMISES:
            if promise.kind != fault.kind:
                continue
            for follower in _concerned(record, fault, promise):
                yield from _unsaid(record, fault, promise, follower)


def _concerned(record: FlightRecord, fault: FaultSection, promise: Promise) -> list[int]:
    """The followers (system ids) that a promise is about."""
    everybody = list(range(2, 2 + record.follower_count))
    leaders = fault.vehicle == LEADER
    if fault.kind == "outage":
        leads = promise.says.startswith("leader")
        reaches = fault.way != "up"
        return (
            (everybody if leads else [fault.vehicle or 0]) if leads is leaders and reaches else []
        )
    if leaders or fault.vehicle is None:
        return everybody
    return [fault.vehicle]


def _unsaid(
    record: FlightRecord, fault: FaultSection, promise: Promise, follower: int
) -> Iterator[tuple[float, int, str]]:
    begins_s = fault.at_s
    by_s = begins_s + promise.after_s + SLACK_S + _link_s(record)
    lasts_s = min(fault.ends_s, float(record.time_s[-1])) - begins_s
    if fault.kind != "tool_stopped" and lasts_s < max(promise.needs_s, by_s - begins_s):
        return
    if by_s > record.time_s[-1] or not _could_be_noticed(record, promise, follower, begins_s, by_s):
        return
    says = promise.says.format(
        id=follower, who="leader" if fault.vehicle == LEADER else f"follower {follower}: it"
    )
    said = (
        record.events
        if not promise.by_vehicle
        else [(t_s, text) for t_s, vehicle, text in record.texts if vehicle == follower]
    )
    # What was said shortly before need not be said again (a state that comes and goes).
    if not any(begins_s - 10.0 <= t_s <= by_s and re.search(says, text) for t_s, text in said):
        yield by_s, follower, f"{fault.told}: nobody said {says!r} by {by_s:.1f} s"


def _link_s(record: FlightRecord) -> float:
    radio = record.scenario.radio
    return max(one.latency_s + one.jitter_s for one in (radio.leader, radio.follower))


def _could_be_noticed(
    record: FlightRecord, promise: Promise, follower: int, begins_s: float, by_s: float
) -> bool:
    """Whether the follower was led when it began, and nothing else hid it since."""
    number = follower - 2
    first = max(0, round(begins_s / SAMPLE_S) - 11)
    began, by = round(begins_s / SAMPLE_S) - 1, round(by_s / SAMPLE_S)
    led: Bools = record.guided[:, number] & (record.stream_age_s[:, number] < 1.0) & record.tool
    held = any(record.hold[at][number] for at in range(first, max(first + 1, began)))
    others = any(
        one.kind != promise.kind and one.kind not in _HARMLESS
        for at in range(first, min(by, len(record.in_force)))
        for one in record.in_force[at]
    )
    radio = record.scenario.radio
    lossy = max(radio.leader.frames_lost, radio.follower.frames_lost) > 0.1
    applet = bool(record.applet[first:by, number].all())
    silent = promise.by_vehicle and not applet
    return bool(np.all(led[first : max(first + 1, began)])) and not (
        held or others or silent or lossy
    )


# Faults that do not change who says what.
_HARMLESS = {"narrow_beam", "home_differs", "late_echoes", "servo_jammed", "leader_climbs"}
