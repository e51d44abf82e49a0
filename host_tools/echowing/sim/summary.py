"""Fly a scenario of either kind and sum it up: the one entrance for commands and tests."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from echowing.analysis.flight import Flight
from echowing.analysis.metrics import Metrics, approach_s, dead_locked, metrics
from echowing.analysis.tables import Result
from echowing.errors import EchowingError
from echowing.sim.aircraft import MakeCoprocessor, SimFollower
from echowing.sim.boards.coprocessor import Coprocessor, SonarBus
from echowing.sim.flight import FormationFlight, Progress
from echowing.sim.hangar import board_parameters
from echowing.sim.scenario import Scenario
from echowing.sim.wall import fly_at_wall

# How an applet tells of an error that it caught, and ArduPilot of a script that it ended.
APPLET_FAILED = ("ECHO: error", "Lua: ")


@dataclass(frozen=True)
class FlownScenario:
    """One scenario flown with one seed.

    metrics and flights: one a follower, in the formation's order. closest_m: the least distance
    between any two vehicles, or to the wall. locked: which followers are dead-locked. phases:
    the least distance by part of a leader's script. commanded_slot: of the slot that the guidance
    had in mind, seen from where the leader truly was (thesis 4.2.3): mean_m, std_m, max_error_m.
    """

    scenario: str
    law: str
    seed: int
    flights: list[Flight]
    metrics: list[Metrics]
    closest_m: float
    simulated_s: float
    wall_s: float
    locked: tuple[bool, ...] = ()
    phases: dict[str, float] = field(default_factory=dict)
    commanded_slot: dict[str, float] = field(default_factory=dict)
    events: list[tuple[float, str]] = field(default_factory=list)

    def results(self, name: str = "") -> list[Result]:
        """One a follower, for the tables, under `name` or the scenario's."""
        locked = self.locked or (False,) * len(self.metrics)
        return [
            Result(name or self.scenario, one, lost, self.seed, self.law)
            for one, lost in zip(self.metrics, locked, strict=True)
        ]

    @property
    def dead_locked(self) -> bool:
        """Whether a follower's law has lost the leader for good."""
        return any(self.locked)

    @property
    def summaries(self) -> list[dict[str, Any]]:
        """One JSON-ready object a follower."""
        return [self._summary(number) for number in range(len(self.flights))]

    def _summary(self, number: int) -> dict[str, Any]:
        summary: dict[str, Any] = {
            "scenario": self.scenario,
            "seed": self.seed,
            "law": self.law,
            "follower": number + 1,
            **self.metrics[number].to_json(),
            "closest_m": round(self.closest_m, 3),
            "dead_locked": self.dead_locked,
            "simulated_s": round(self.simulated_s, 3),
            "wall_s": round(self.wall_s, 3),
        }
        if self.phases:
            summary["phases"] = {label: round(m, 3) for label, m in self.phases.items()}
        if self.commanded_slot:
            summary["commanded_slot"] = {k: round(v, 3) for k, v in self.commanded_slot.items()}
        return summary


def fly(
    scenario: Scenario,
    seed: int,
    *,
    out: Path | None = None,
    firmware: str = "native",
    progress: Progress | None = None,
) -> FlownScenario:
    """Fly `scenario` with `seed`; with `out`, logs and truth are written there.

    firmware: "native" (the core built for this machine) or "avr" (the board's binary, emulated).
    Raises EchowingError if the applet failed: that flight is not one with its law.
    """
    make_coprocessor = _coprocessors(scenario, seed, firmware)
    if scenario.kind == "wall":
        return _wall(scenario, seed, make_coprocessor)
    flight = FormationFlight(scenario, seed, out=out, make_coprocessor=make_coprocessor)
    result = flight.run(progress)
    _refuse_failed(scenario, flight.followers)
    measured = [metrics(one, _settle_s(one, scenario)) for one in result.flights]
    return FlownScenario(
        scenario=scenario.name,
        law=scenario.law_name,
        seed=seed,
        flights=result.flights,
        metrics=measured,
        closest_m=result.closest_m,
        simulated_s=result.simulated_s,
        wall_s=result.wall_s,
        locked=tuple(dead_locked(one) for one in result.flights),
        phases=result.phases,
        commanded_slot=_commanded(result.commanded_slot_m, scenario, measured[0].settle_s),
        events=result.events,
    )


def _coprocessors(scenario: Scenario, seed: int, firmware: str) -> MakeCoprocessor | None:
    if firmware == "native":
        return None
    if firmware != "avr":
        raise EchowingError(f"--firmware {firmware!r}: native or avr")
    from echowing.sim.boards.avr import avr_coprocessor  # noqa: PLC0415 (needs the emulator built)

    def make(bus: SonarBus, system_id: int) -> Coprocessor:
        return avr_coprocessor(bus, seed=seed, parameters=board_parameters(system_id, scenario))

    return make


def _refuse_failed(scenario: Scenario, followers: Sequence[SimFollower]) -> None:
    """Name the first error of an applet: its own word, or the scripting engine's."""
    for follower in followers:
        for t_s, text in follower.autopilot.texts:
            if text.startswith(APPLET_FAILED):
                raise EchowingError(f"{scenario.applet_file}: failed after {t_s:.1f} s: {text}")


def _wall(scenario: Scenario, seed: int, make_coprocessor: MakeCoprocessor | None) -> FlownScenario:
    result = fly_at_wall(scenario, seed, make_coprocessor=make_coprocessor)
    flight = replace(result.flight, name=scenario.name, law=scenario.law_name, seed=seed)
    return FlownScenario(
        scenario=scenario.name,
        law=scenario.law_name,
        seed=seed,
        flights=[flight],
        metrics=[metrics(flight)],
        closest_m=result.closest_m,
        simulated_s=float(flight.time_s[-1]),
        wall_s=result.wall_s,
    )


def _settle_s(flight: Flight, scenario: Scenario) -> float:
    return approach_s(flight) if scenario.settle_s is None else scenario.settle_s


def _commanded(distances_m: list[float], scenario: Scenario, settle_s: float) -> dict[str, float]:
    """Statistics of the distance from the leader to the commanded slot, once settled."""
    first = round(settle_s * 10.0)
    distances = np.array(distances_m[first:])
    if distances.size == 0 or not math.isfinite(float(distances.sum())):
        return {}
    wanted_m = scenario.formation.slots[0].radius_m
    return {
        "mean_m": float(distances.mean()),
        "std_m": float(distances.std()),
        "max_error_m": float(np.abs(distances - wanted_m).max()),
    }
