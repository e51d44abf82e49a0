"""A whole flight in lock step: leader, radios, guidance, followers, sonars. Deterministic.

What passes between the parts is MAVLink bytes; the co-processor runs the firmware's core and the
follower's autopilot runs the applet of the SD card. Only this file knows the truth about
everybody, and only the physics and the recorder are told.
"""

import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from echowing.analysis.flight import Flight
from echowing.flight.envelope import LEAST_M
from echowing.flight.follower import FollowerPlan, FollowerState
from echowing.flight.formation import flown_up
from echowing.flight.guard import FIELD_LIMITS, Limits
from echowing.flight.guidance import MOVING_MPS, Horizontal, Slot, place_m
from echowing.flight.lowest import LOWEST_M
from echowing.flight.readiness import Readiness
from echowing.flight.session import FollowSession
from echowing.flight.switch import StopSwitch
from echowing.geo import Ned, ned_between
from echowing.sim.aircraft import LeaderPilot, MakeCoprocessor, SimFollower, SimVehicle
from echowing.sim.faults import SWITCH_CHANNEL, Faults
from echowing.sim.ground import GroundStation
from echowing.sim.hangar import FIRST_FOLLOWER_ID, LEADER_ID, Hangar
from echowing.sim.own_plan import OwnPlan, OwnPlanStep
from echowing.sim.recorder import Recorder, Sample, write_truth
from echowing.sim.scenario import Scenario, SwarmSection
from echowing.sim.vehicle.autopilot import ORIGIN, Autopilot
from echowing.sim.world.pilots import Pilot
from echowing.sim.world.sonar import (
    GROUND,
    Pose,
    Target,
)
from echowing.stopping import waiting_interrupts

STEP_S = 0.02
STEP_US = 20_000
STEPS_PER_SAMPLE = 5  # 10 Hz
SAMPLE_S = STEP_S * STEPS_PER_SAMPLE
SWITCH_PULSE_US = 1700  # as README's example of a stop switch
# Nothing further away than this can matter to a sonar that reports up to 7.65 m.
HEARING_M = 9.0
# Followers start this far outside their slots, as they would be flown up by hand.
JOIN_UP_M = 3.0

Progress = Callable[[float], None]


@dataclass(frozen=True)
class FlightResult:
    """What a flown scenario leaves behind.

    flights: one a follower; closest_m: the least distance between any two vehicles;
    phases: for a scripted leader, the least separation in each part of the script;
    commanded_slot_m: horizontal distance from the leader to the first follower's slot as the
    guidance saw it, 10 Hz, NaN before the first point.
    """

    scenario: Scenario
    seed: int
    flights: list[Flight]
    closest_m: float
    phases: dict[str, float]
    commanded_slot_m: list[float]
    events: list[tuple[float, str]]
    simulated_s: float
    wall_s: float


class FormationWorld:
    """A scenario's leader and followers in one air, applets and sonars at work. Nobody guides."""

    def __init__(self, scenario: Scenario, hangar: Hangar) -> None:
        self.scenario = scenario
        self.hangar = hangar
        self._step = 0
        self.leader = hangar.leader()
        self.pilot = LeaderPilot(self.leader, scenario.leader)
        self._scattered_m = scattered_m(scenario.swarm, hangar.rng("swarm's start"))
        self._flown_up = flown_up(scenario.slots(), LEAST_M)
        self.followers = [self._make_follower(i) for i in range(len(scenario.formation.slots))]

    @property
    def t_s(self) -> float:
        """Simulated time."""
        return self._step * STEP_S

    def slots(self) -> list[Slot]:
        """Each follower's slot now."""
        return self.scenario.slots()

    def watched(self, slot: Slot) -> SimVehicle:
        """The vehicle that the sonar of a slot's follower looks at."""
        return self.leader if slot.behind is None else self.followers[slot.behind]

    def step(self) -> None:
        """One world step of 20 ms."""
        self._step += 1
        t_s, t_us = self.t_s, self._step * STEP_US
        self.pilot.step(t_s, self.followers[0].position_ned_m)
        for vehicle in (self.leader, *self.followers):
            vehicle.move(STEP_S)
        for follower in self.followers:
            follower.run_coprocessor(t_us, STEP_S)
        for vehicle in (self.leader, *self.followers):
            vehicle.autopilot.step(t_s)

    def _make_follower(self, index: int) -> SimFollower:
        body = self.leader.body
        north_m, east_m, down_m = self._start_m(index)
        start = body.north_m + north_m, body.east_m + east_m, body.down_m + down_m
        speed_mps = self.scenario.follower.speed_mps
        return self.hangar.follower(index, start, body.yaw_rad, speed_mps, self._listen)

    def _start_m(self, index: int) -> Ned:
        """Where a follower starts, NED from the leader."""
        if self.scenario.swarm.followers:
            return (*self._scattered_m[index], 0.0)
        slots = list(self._flown_up)
        starts_at = self.scenario.formation.slots[index].starts_at
        number = index if starts_at is None else starts_at - 1
        slots[number] = replace(slots[number], radius_m=slots[number].radius_m + JOIN_UP_M)
        return place_m(slots, number, self.leader.body.yaw_rad)

    def _listen(self, follower: SimFollower, t_s: float) -> float | None:
        """What this follower's sonar hears now."""
        pose = follower.pose()
        sonar = follower.ear.sonar
        heard_to_m = {"foil": sonar.foil_m, "stock": sonar.stock_m}
        leaders_m = heard_to_m[self.scenario.leader.target]
        followers_m = heard_to_m[self.scenario.follower.target]
        legs_m = sonar.legs_m
        targets = [Target(self.leader.position_ned_m, leaders_m, legs_m)]
        others: list[Pose] = []
        for other in self.followers:
            if other is not follower and _near(pose.position_ned_m, other.position_ned_m):
                targets.append(Target(other.position_ned_m, followers_m, legs_m))
                others.append(other.pose())
        targets += follower.reflector(pose)
        return follower.heard(follower.ear.ping(t_s, pose, targets, (GROUND,), others))


class FormationFlight(FormationWorld):
    """A formation guided from the ground over radios, and recorded.

    `make_coprocessor` builds the co-processor on a sonar bus for a system id: the native core by
    default.
    With `out` the telemetry logs and the truth are written there.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        *,
        out: Path | None = None,
        make_coprocessor: MakeCoprocessor | None = None,
    ) -> None:
        hangar = Hangar(scenario, seed, out=out, make_coprocessor=make_coprocessor)
        super().__init__(scenario, hangar)
        self.seed = seed
        self._out = out
        self.closest_m = math.inf
        self.phases: dict[str, float] = {}
        self.ground = self._make_ground()
        self.pilots = [
            Pilot(follower.autopilot, partial(self._state, FIRST_FOLLOWER_ID + index))
            for index, follower in enumerate(self.followers)
        ]
        self.faults = Faults(scenario.fault, self)
        self._shapes, self._changed = scenario.formation.shapes(), 0
        self._objection: str | None = None
        self._course_rad = 0.0
        self._commanded_slot_m: list[float] = []
        self.recorders = [
            Recorder(scenario.name, slot, scenario.law_name, seed) for slot in scenario.slots()
        ]

    def run(
        self, progress: Progress | None = None, after_step: Callable[[], None] | None = None
    ) -> FlightResult:
        """Fly it all. `progress` is told the simulated seconds flown, once a second.

        `after_step` is called after each step, for whoever watches.
        """
        started_s = time.perf_counter()
        steps = round(self.scenario.duration_s / STEP_S)
        with waiting_interrupts() as raise_asked:
            while self._step < steps:
                self.step()
                raise_asked()
                if after_step is not None:
                    after_step()
                if progress is not None and self._step % 50 == 0:
                    progress(self.t_s)
        return self._result(time.perf_counter() - started_s)

    def step(self) -> None:
        """One world step of 20 ms, and what the ground makes of it."""
        self.faults.step(self.t_s)
        super().step()
        self.ground.links[LEADER_ID].down.silent = self.pilot.silent
        self.ground.step(self.t_s)
        self._reshape()
        for pilot in self.pilots:
            pilot.step(self.t_s)
        self._watch()
        if self._step % STEPS_PER_SAMPLE == 0:
            self._record()

    def _reshape(self) -> None:
        """Let the formation take its next shape, as its operator would by a key."""
        reshape, changes = self.ground.session.reshape, self.scenario.formation.changes
        if self._changed == len(changes) or self.t_s < changes[self._changed].at_s:
            return
        shape = self._shapes[self._changed + 1]
        objection = reshape.objection(shape)
        if objection is None:
            self._changed += 1
            reshape.begin(shape, self.t_s)
        elif objection != self._objection:
            self.ground.session.events.append((self.t_s, f"no {shape[0]} yet: {objection}"))
        self._objection = objection

    def slots(self) -> list[Slot]:
        """As its session has them: they take other shapes, and close gaps."""
        return [one.slot for one in self.ground.session.followers.values()]

    def _state(self, system_id: int) -> FollowerState:
        return self.ground.session.followers[system_id]

    def new_session(self) -> FollowSession:
        """A session as the ground tool begins one."""
        scenario = self.scenario
        # A leader that is carried may be lower than any follower is flown.
        altitude_m = max(LOWEST_M, scenario.leader.altitude_m)
        sonar = scenario.sonar_belief
        plans = [
            FollowerPlan(FIRST_FOLLOWER_ID + i, slot, altitude_m, sonar=sonar)
            for i, slot in enumerate(scenario.slots())
        ]
        session = FollowSession(
            LEADER_ID,
            plans,
            scenario.guidance_settings(),
            leader_rate_hz=scenario.guidance.telemetry_hz,
            limits=None if scenario.guidance.gray else _limits(scenario),
        )
        if scenario.plan is not None:
            session.plan = OwnPlanStep(OwnPlan(Path(scenario.plan)), session)
        return session

    def _make_ground(self) -> GroundStation:
        scenario = self.scenario
        links = {LEADER_ID: self.hangar.telemetry(self.leader, "leader", scenario.radio.leader)}
        for system_id, follower in enumerate(self.followers, FIRST_FOLLOWER_ID):
            name = f"follower-{system_id}"
            links[system_id] = self.hangar.telemetry(follower, name, scenario.radio.follower)
        return GroundStation(self.new_session(), links, scenario.guidance.rate_hz)

    def _watch(self) -> None:
        """Keep the least distance between any two vehicles, and by part of the script."""
        leader_m = min(
            math.dist(self.leader.position_ned_m, f.position_ned_m) for f in self.followers
        )
        closest_m = min(leader_m, self._followers_apart_m())
        self.closest_m = min(self.closest_m, closest_m)
        if self.pilot.event is not None:
            label = self.pilot.event.label or self.pilot.event.act
            self.phases[label] = min(self.phases.get(label, math.inf), closest_m)

    def _followers_apart_m(self) -> float:
        # Fifty followers have 1225 pairs: once a sample is often enough for what drifts slowly.
        if len(self.followers) < 2 or self._step % STEPS_PER_SAMPLE:
            return math.inf
        positions = [follower.position_ned_m for follower in self.followers]
        return min(math.dist(a, b) for i, a in enumerate(positions) for b in positions[:i])

    def _record(self) -> None:
        body = self.leader.body
        if math.hypot(body.vn_mps, body.ve_mps) >= MOVING_MPS:
            self._course_rad = math.atan2(body.ve_mps, body.vn_mps)
        for follower, slot, recorder in zip(
            self.followers, self.slots(), self.recorders, strict=True
        ):
            recorder.samples.append(self._sample(follower, self.watched(slot)))
        self._commanded_slot_m.append(self._commanded_slot())

    def _commanded_slot(self) -> float:
        guided = self.ground.session.followers[FIRST_FOLLOWER_ID].guided
        if guided is None:
            return math.nan
        north_m, east_m, _ = ned_between(ORIGIN, guided.slot)
        return math.hypot(north_m - self.leader.body.north_m, east_m - self.leader.body.east_m)

    def _sample(self, follower: SimFollower, ahead: SimVehicle) -> Sample:
        """What is recorded of a follower, and as its leader the vehicle its sonar looks at."""
        return Sample(
            time_s=self.t_s,
            leader=ahead.position_ned_m,
            leader_velocity=ahead.velocity_ned_mps,
            leader_course_rad=self._course_rad,
            follower=follower.position_ned_m,
            follower_velocity=follower.velocity_ned_mps,
            follower_yaw_rad=follower.body.yaw_rad,
            sonar_m=follower.sensor.last_range_m,
            speed_command_mps=speed_parameter_mps(follower.autopilot),
            pan_us=follower.coprocessor.pan_us,
            tilt_us=follower.coprocessor.tilt_us,
        )

    def _result(self, wall_s: float) -> FlightResult:
        flights = [recorder.flight() for recorder in self.recorders]
        for link in self.ground.links.values():
            link.close()
        if self._out is not None:
            for number, flight in enumerate(flights, FIRST_FOLLOWER_ID):
                name = "truth.csv" if len(flights) == 1 else f"truth-{number}.csv"
                write_truth(self._out / name, flight)
        return FlightResult(
            scenario=self.scenario,
            seed=self.seed,
            flights=flights,
            closest_m=self.closest_m,
            phases=self.phases,
            commanded_slot_m=self._commanded_slot_m,
            events=self.ground.events,
            simulated_s=self.t_s,
            wall_s=wall_s,
        )


def _limits(scenario: Scenario) -> Limits:
    """What the field flies with: the defaults of `echowing follow`.

    What an operator would have been asked is answered here by the scenario.
    """
    told = Readiness(
        applet=scenario.law != "none",
        distance=False,
        sides=False,
        homes_told=True,
        height_told=True,
    )
    leader_flies = scenario.leader.path not in ("walk", "track")
    switched = any(fault.kind == "stop_switch" for fault in scenario.fault)
    switch = StopSwitch(SWITCH_CHANNEL, SWITCH_PULSE_US) if switched else None
    return replace(FIELD_LIMITS, leader_flies=leader_flies, ready=told, switch=switch)


def scattered_m(swarm: SwarmSection, chance: random.Random) -> list[Horizontal]:
    """Where a swarm starts, (north, east) of a leader that heads north: anywhere behind it."""
    places_m: list[Horizontal] = []
    wide_m, first_m = swarm.scatter_m * math.sqrt(swarm.followers), swarm.near_m + JOIN_UP_M
    while len(places_m) < swarm.followers:
        back_m = first_m + chance.uniform(0.0, 1.5 * wide_m)
        place_m = -back_m, chance.uniform(-wide_m, wide_m)
        if all(math.dist(place_m, other_m) >= swarm.scatter_m for other_m in places_m):
            places_m.append(place_m)
    return places_m


def speed_parameter_mps(autopilot: Autopilot) -> float | None:
    """The speed parameter in force, whichever the generation."""
    metres = autopilot.parameter_get("WP_SPD")
    if metres is not None:
        return metres
    centimetres = autopilot.parameter_get("WPNAV_SPEED")
    return None if centimetres is None else centimetres / 100.0


def _near(a: Ned, b: Ned) -> bool:
    return abs(a[0] - b[0]) < HEARING_M and abs(a[1] - b[1]) < HEARING_M
