"""The record of one flight: all the data that its properties are judged by, and no judgement.

It is taken from the truth and from the bytes that pass the radios, not from what the flight core
believes, so that it shows a core that is wrong about itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.flight import Flight, Floats
from echowing.flight.steps import Standing
from echowing.sim.fault_section import LEADER, FaultSection
from echowing.sim.flight import (
    STEPS_PER_SAMPLE,
    FlightResult,
    FormationFlight,
    speed_parameter_mps,
)
from echowing.sim.ground import message_id
from echowing.sim.scenario import Scenario
from echowing.sim.vehicle.modes import GUIDED

_PAYLOAD = 10  # where it begins in a MAVLink 2 frame
_POINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
_SWITCH_OFFSET, _SWITCH_ON_US = _PAYLOAD + 16, 1700  # chan7_raw of RC_CHANNELS
_NEVER = -math.inf

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Point:
    """A guided point that the tool sent, with what the vehicle had reported until then."""

    time_s: float
    vehicle: int
    known_mode: int | None
    known_flying: bool


@dataclass(frozen=True)
class FlightRecord:
    """One flight, n samples at 10 Hz, v vehicles (the leader first), f = v - 1 followers.

    position_ned_m, velocity_ned_mps: true, (n, v, 3). receiver_error_m: its own estimate less the
    true position, north and east, (n, v, 2). lean_rad: off upright, (n, v). height_m: above its
    home by its own estimate, (n, v). mode, flying: the autopilot's, (n, v). least_m: the
    least true distance of each pair since the sample before, (n, p), pairs as in `pairs`, indices
    of vehicles from 0. leader_age_s: age of the newest position of the leader that has reached the
    tool, (n,). stream_age_s: since a point last reached the follower, (n, f). speed_mps: its speed
    parameter, (n, f), m/s. applet: whether the applet runs, (n, f). applet_state: as it reports it,
    (n, f). switched: whether a stop switch that is on has been reported to the tool since the
    follower entered Guided, (n, f). tool: whether the ground tool runs, (n,). hold: why the tool
    holds the follower, empty: it does not, n lists of f. sonar_m: (n, f), NaN: nothing.
    """

    scenario: Scenario
    seed: int
    time_s: Floats
    lean_rad: Floats
    position_ned_m: Floats
    velocity_ned_mps: Floats
    receiver_error_m: Floats
    height_m: Floats
    mode: Ints
    flying: Bools
    pairs: tuple[tuple[int, int], ...]
    least_m: Floats
    leader_age_s: Floats
    stream_age_s: Floats
    speed_mps: Floats
    applet: Bools
    applet_state: Ints
    switched: Bools
    tool: Bools
    hold: list[list[str]]
    sonar_m: Floats
    in_force: list[list[FaultSection]]
    points: list[Point]
    texts: list[tuple[float, int, str]]
    events: list[tuple[float, str]]
    flights: list[Flight]
    pilot_speed_mps: float

    @property
    def guided(self) -> Bools:
        """Which followers are in the air and in Guided, (n, f)."""
        return np.asarray((self.mode[:, 1:] == GUIDED) & self.flying[:, 1:])

    @property
    def follower_count(self) -> int:
        """How many followers there are."""
        return int(self.position_ned_m.shape[1]) - 1

    @property
    def speed_over_ground_mps(self) -> Floats:
        """True horizontal speeds, (n, v)."""
        return np.asarray(np.linalg.norm(self.velocity_ned_mps[:, :, :2], axis=2))

    @property
    def closest_m(self) -> float:
        """The least distance between any two vehicles."""
        return float(self.least_m.min())


@dataclass
class _Link:
    """What has passed on one vehicle's link."""

    vehicle: int
    point_at_s: float = _NEVER
    measured_s: float = _NEVER
    mode: int | None = None
    flying: bool = False
    switch_on: bool = False


@dataclass
class Observer:
    """Watches a flight, step by step, and makes its record."""

    flight: FormationFlight
    _links: dict[int, _Link] = field(default_factory=dict)
    _points: list[Point] = field(default_factory=list)
    _rows: dict[str, list[object]] = field(default_factory=dict)
    _steps: int = 0

    def __post_init__(self) -> None:
        for system_id, link in self.flight.ground.links.items():
            watch = self._links[system_id] = _Link(system_id)
            link.tap = lambda what, t_s, frame, watch=watch: self._passes(watch, what, t_s, frame)
        vehicles = [self.flight.leader, *self.flight.followers]
        self._vehicles = vehicles
        self._pairs = tuple(combinations(range(len(vehicles)), 2))
        self._least = [math.inf] * len(self._pairs)
        self._switched = [False] * len(self.flight.followers)

    def step(self) -> None:
        """Observe the flight after a step."""
        self._steps += 1
        places = [vehicle.position_ned_m for vehicle in self._vehicles]
        least = self._least
        for number, (a, b) in enumerate(self._pairs):
            least[number] = min(least[number], math.dist(places[a], places[b]))
        if self._steps % STEPS_PER_SAMPLE == 0:
            self._sample()

    def _passes(self, watch: _Link, what: str, t_s: float, frame: bytes) -> None:
        kind = message_id(frame)
        if kind == _POINT and what == "delivered":
            watch.point_at_s = t_s
        elif kind == _POINT and what == "sent":
            self._points.append(Point(t_s, watch.vehicle, watch.mode, watch.flying))
        elif what == "arrived" and self.flight.ground.running:
            self._arrives(watch, kind, frame)

    def _arrives(self, watch: _Link, kind: int, frame: bytes) -> None:
        if kind == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            measured_s = int.from_bytes(frame[_PAYLOAD : _PAYLOAD + 4], "little") / 1e3
            watch.measured_s = max(watch.measured_s, measured_s)
        elif kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT and frame[6] == 1:
            watch.mode = int.from_bytes(frame[_PAYLOAD : _PAYLOAD + 4], "little")
            armed = frame[_PAYLOAD + 6] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            watch.flying = bool(armed) and frame[_PAYLOAD + 7] >= mavlink.MAV_STATE_ACTIVE
        elif kind == mavlink.MAVLINK_MSG_ID_RC_CHANNELS:
            pulse_us = int.from_bytes(frame[_SWITCH_OFFSET : _SWITCH_OFFSET + 2], "little")
            watch.switch_on = pulse_us > _SWITCH_ON_US

    def _sample(self) -> None:
        flight, row = self.flight, self._row
        t_s = flight.t_s
        vehicles, followers = self._vehicles, flight.followers
        row("time_s", t_s)
        row("position", [vehicle.position_ned_m for vehicle in vehicles])
        row("velocity", [vehicle.velocity_ned_mps for vehicle in vehicles])
        bodies = [vehicle.body for vehicle in vehicles]
        errors = [(b.est_north_m - b.north_m, b.est_east_m - b.east_m) for b in bodies]
        row("receiver_error", errors)
        row("lean", [math.hypot(one.body.roll_rad, one.body.pitch_rad) for one in vehicles])
        row("height", [vehicle.autopilot.height_above_home_m() for vehicle in vehicles])
        row("mode", [vehicle.autopilot.modes.mode for vehicle in vehicles])
        row("flying", [vehicle.autopilot.modes.flying for vehicle in vehicles])
        row("least", self._least)
        self._least = [math.inf] * len(self._pairs)
        row("leader_age", t_s - self._links[LEADER].measured_s)
        ids = [follower.autopilot.system_id for follower in followers]
        row("stream_age", [t_s - self._links[one].point_at_s for one in ids])
        row("speed", [speed_parameter_mps(one.autopilot) or math.nan for one in followers])
        row("applet", [one.autopilot.script is not None for one in followers])
        states = [one.autopilot.named_floats.get("ECHO_STATE", 0.0) for one in followers]
        row("applet_state", [round(state) for state in states])
        row("switched", self._note_switches(ids))
        row("tool", flight.ground.running)
        session = flight.ground.session
        row("hold", [_why_held(session.followers[one].standing) for one in ids])
        heard = [follower.sensor.last_range_m for follower in followers]
        row("sonar", [math.nan if range_m is None else range_m for range_m in heard])
        row("in_force", flight.faults.in_force)

    def _note_switches(self, ids: Sequence[int]) -> list[bool]:
        """A switch that was on stops a follower until it has left Guided.

        Put off before the tool has heard of Guided it stops nobody.
        """
        leaders = self._links[LEADER].switch_on
        for number, system_id in enumerate(ids):
            watch, follower = self._links[system_id], self.flight.followers[number].autopilot.modes
            led = follower.mode == GUIDED and follower.flying and watch.mode == GUIDED
            self._switched[number] = leaders or watch.switch_on or (self._switched[number] and led)
        return list(self._switched)

    def _row(self, name: str, value: object) -> None:
        self._rows.setdefault(name, []).append(value)

    def record(self, result: FlightResult) -> FlightRecord:
        """The record of what was observed."""
        rows = self._rows
        texts = [
            (t_s, number, text)
            for number, vehicle in enumerate(self._vehicles, LEADER)
            for t_s, text in vehicle.autopilot.texts
        ]
        return FlightRecord(
            scenario=result.scenario,
            seed=result.seed,
            time_s=np.array(rows["time_s"], dtype=float),
            lean_rad=np.array(rows["lean"], dtype=float),
            position_ned_m=np.array(rows["position"], dtype=float),
            velocity_ned_mps=np.array(rows["velocity"], dtype=float),
            receiver_error_m=np.array(rows["receiver_error"], dtype=float),
            height_m=np.array(rows["height"], dtype=float),
            mode=np.array(rows["mode"], dtype=np.int64),
            flying=np.array(rows["flying"], dtype=np.bool_),
            pairs=self._pairs,
            least_m=np.array(rows["least"], dtype=float),
            leader_age_s=np.array(rows["leader_age"], dtype=float),
            stream_age_s=np.array(rows["stream_age"], dtype=float),
            speed_mps=np.array(rows["speed"], dtype=float),
            applet=np.array(rows["applet"], dtype=np.bool_),
            applet_state=np.array(rows["applet_state"], dtype=np.int64),
            switched=np.array(rows["switched"], dtype=np.bool_),
            tool=np.array(rows["tool"], dtype=np.bool_),
            hold=list(rows["hold"]),  # type: ignore[arg-type]
            sonar_m=np.array(rows["sonar"], dtype=float),
            in_force=list(rows["in_force"]),  # type: ignore[arg-type]
            points=self._points,
            texts=sorted(texts),
            events=result.events,
            flights=result.flights,
            pilot_speed_mps=result.scenario.follower.speed_mps,
        )


def _why_held(standing: Standing) -> str:
    return standing.why if standing.held else ""


def fly_recorded(scenario: Scenario, seed: int) -> FlightRecord:
    """Fly a scenario as `echowing sim` does, and keep its record."""
    flight = FormationFlight(scenario, seed)
    observer = Observer(flight)
    return observer.record(flight.run(after_step=observer.step))
