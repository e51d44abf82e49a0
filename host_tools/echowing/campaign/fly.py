"""One flight of a campaign: drawn, flown, judged, and summed up in a row of plain values."""

import gc
import math
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from echowing.analysis.logs import read_flights
from echowing.analysis.metrics import approach_s, metrics
from echowing.campaign.draw import Description, draw, flight_seed
from echowing.campaign.properties import Broken, judge, nothing_wrong
from echowing.campaign.record import FlightRecord, Observer
from echowing.campaign.swarm import Swarm, swarm
from echowing.errors import EchowingError
from echowing.sim.fault_section import LEADER
from echowing.sim.flight import SAMPLE_S, FormationFlight
from echowing.sim.scenario import Scenario
from echowing.sim.vehicle.autopilot import AutopilotEndedError

Row = dict[str, Any]
# The logs of one flight in so many are written and read: that takes as long as the flight.
LOGS_EVERY = 20
# Objects between two garbage collections; Python's 700 take a twentieth of a flight's time.
COLLECTED_EVERY = 50_000
CRASHED, LOGS = "no error", "logs readable"
# The applet's states by number (lua/echowing.md).
_APPLET = (
    "off",
    "searching",
    "tracking",
    "too close",
    "no sonar data",
    "stream lost",
    "backing off",
    "holding the distance",
)


@dataclass(frozen=True)
class Judged:
    """A flight with what it broke; `record` is None where it could not be flown to its end."""

    record: FlightRecord | None
    broken: list[Broken]


def fly_and_judge(scenario: Scenario, seed: int, *, logs: bool = False) -> Judged:
    """Fly a scenario as `echowing sim` does and check every property."""
    if not logs:
        return _flown(scenario, seed, None)
    with TemporaryDirectory() as folder:
        judged = _flown(scenario, seed, Path(folder))
        unread = [] if judged.record is None else _unreadable(judged.record, Path(folder))
        return Judged(judged.record, judged.broken + unread)


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Collect garbage seldom: a flight leaves no reference cycles behind while it lasts."""
    before = gc.get_threshold()
    gc.set_threshold(COLLECTED_EVERY, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


@_seldom_collected()
def _flown(scenario: Scenario, seed: int, out: Path | None) -> Judged:
    flight: FormationFlight | None = None
    try:
        flight = FormationFlight(scenario, seed, out=out)
        observer = Observer(flight)
        record = observer.record(flight.run(after_step=observer.step))
    except AutopilotEndedError as error:
        at_s = 0.0 if flight is None else flight.t_s
        return Judged(None, [Broken(CRASHED, at_s, error.system_id, 0.0, str(error))])
    except EchowingError:
        raise
    except Exception as error:  # whatever it is, it is what a campaign looks for
        at_s = 0.0 if flight is None else flight.t_s
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"
        return Judged(None, [Broken(CRASHED, at_s, 0, 0.0, text)])
    return Judged(record, judge(record))


def _unreadable(record: FlightRecord, folder: Path) -> list[Broken]:
    """Whether `echowing analyze` reads what was logged, and finds every follower in it."""
    logs = sorted(folder.glob("*.tlog"))
    end_s = float(record.time_s[-1])
    try:
        found = len(read_flights(logs, leader=LEADER))
    except EchowingError as error:
        return [Broken(LOGS, end_s, 0, 0.0, f"the logs cannot be read: {error}")]
    if found == record.follower_count:
        return []
    text = f"of {record.follower_count} followers the logs show {found}"
    return [Broken(LOGS, end_s, 0, float(found), text)]


def fly_one(description: Description, seed: int, index: int) -> Row:
    """Flight number `index` of a campaign as a row; the same wherever and whenever it is flown."""
    scenario = draw(description, seed, index)
    own_seed = flight_seed(seed, index)
    judged = fly_and_judge(scenario, own_seed, logs=index % LOGS_EVERY == 0)
    return {
        "index": index,
        "seed": own_seed,
        **_drawn(scenario),
        **({} if judged.record is None else _measured(judged.record)),
        "broken": [asdict(one) for one in judged.broken],
    }


def _drawn(scenario: Scenario) -> Row:
    """What the flight was, in columns."""
    radio = scenario.radio.leader
    return {
        "path": scenario.leader.path,
        "leader_mps": scenario.leader.speed_mps,
        "followers": len(scenario.formation.slots),
        "radius_m": scenario.formation.slots[0].radius_m,
        "velocity_sent": scenario.guidance_settings().feed_forward,
        "generation": scenario.follower.generation,
        "wind_mps": scenario.wind.speed_mps,
        "turbulence": scenario.wind.turbulence,
        "gps_sigma_m": scenario.gps.sigma_m,
        "latency_s": radio.latency_s + radio.jitter_s,
        "loss": radio.loss,
        "byte_loss": max(radio.byte_loss, scenario.radio.follower.byte_loss),
        "wire_byte_loss": scenario.wire.byte_loss,
        "faults": [fault.kind for fault in scenario.fault],
        "duration_s": scenario.duration_s,
    }


def _measured(record: FlightRecord) -> Row:
    leads = [number for number, (a, _) in enumerate(record.pairs) if a == 0]
    others = [number for number, (a, _) in enumerate(record.pairs) if a != 0]
    figures = [metrics(one, approach_s(one)) for one in record.flights]
    return {
        "closest_m": round(record.closest_m, 3),
        "closest_to_leader_m": round(float(record.least_m[:, leads].min()), 3),
        "closest_followers_m": (
            round(float(record.least_m[:, others].min()), 3) if others else None
        ),
        "mean_error_m": _plain(figures[0].mean_abs_error_m),
        "rmsd_m": _plain(figures[0].rmsd_m),
        "nothing_wrong": nothing_wrong(record),
        **_formation(record),
        "in_force_s": _rounded(_in_force(record)),
        "states_s": _rounded(_states(record)),
    }


def _formation(record: FlightRecord) -> Row:
    """How the formation kept together, in columns; None: there are no figures of it."""
    figures = swarm(record)
    names = [one.name for one in fields(Swarm)]
    return {name: None if figures is None else _plain(getattr(figures, name)) for name in names}


def _plain(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None


def _rounded(counts: Counter[str]) -> dict[str, float]:
    return {name: round(samples * SAMPLE_S, 1) for name, samples in sorted(counts.items())}


def _in_force(record: FlightRecord) -> Counter[str]:
    """Samples in which each fault, and each pair of faults (`a + b`), was in force."""
    counts: Counter[str] = Counter()
    for faults in record.in_force:
        kinds = sorted({fault.kind for fault in faults})
        counts.update(kinds)
        counts.update(f"{a} + {b}" for n, a in enumerate(kinds) for b in kinds[n + 1 :])
    return counts


def _states(record: FlightRecord) -> Counter[str]:
    """Samples in which a fault met a follower in a state, as `fault: state`."""
    counts: Counter[str] = Counter()
    guided = record.guided
    for at, faults in enumerate(record.in_force):
        for fault in faults:
            for number in _met(record, fault.vehicle):
                counts[f"{fault.kind}: {_state(record, guided, at, number)}"] += 1
    return counts


def _met(record: FlightRecord, vehicle: int | None) -> Sequence[int]:
    return range(record.follower_count) if vehicle in (None, 1) else [(vehicle or 0) - 2]


def _state(record: FlightRecord, guided: np.ndarray, at: int, number: int) -> str:
    if not guided[at, number]:
        return "its pilot's"
    if record.hold[at][number]:
        return "held"
    if not record.applet[at, number]:
        return "no applet"
    return _APPLET[int(record.applet_state[at, number]) % len(_APPLET)]
