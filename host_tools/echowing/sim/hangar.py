"""Builds the vehicles of a scenario: bodies, autopilots, receivers, sonar rigs, radio links."""

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from echowing.flight.by_sonar import TRACK_RANGE, applet_by_sonar, board_by_sonar
from echowing.geo import Ned
from echowing.setup.settings import LEAST_LIMITS
from echowing.sim.aircraft import Body, MakeCoprocessor, SensorDriver, SimFollower, SimVehicle
from echowing.sim.boards.coprocessor import NativeCoprocessor
from echowing.sim.ground import Telemetry, open_log
from echowing.sim.scenario import SPEED_LAWS, LossySection, RadioSection, Scenario
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.copter import Copter, Tuning, tuning_of
from echowing.sim.vehicle.parameters import Generation, spans_of
from echowing.sim.world.cutter import PacketCutter
from echowing.sim.world.gps import Drift
from echowing.sim.world.leader import TrackedBody, load_track, walk
from echowing.sim.world.radio import Radio
from echowing.sim.world.sonar import Ear
from echowing.sim.world.truth import true_errors, true_sonar
from echowing.sim.world.wind import Wind

LEADER_ID = 1
FIRST_FOLLOWER_ID = 2
HEIGHT_BY_RECEIVER = 3.0  # EK3_SRC1_POSZ

Listen = Callable[[SimFollower, float], float | None]


def board_parameters(system_id: int, scenario: Scenario) -> dict[str, float]:
    """The co-processor's parameters: it has learned long ago whose it is."""
    track_cm = board_by_sonar(scenario.sonar_belief)[TRACK_RANGE].value
    return {"SYS_ID": float(system_id), TRACK_RANGE: track_cm, **scenario.coprocessor}


def _set_up(generation: Generation) -> dict[str, float]:
    """The limits that `setup apply` gives a vehicle as it comes."""
    names = spans_of(generation)
    return {
        name: least / unit
        for limit, least in LEAST_LIMITS.items()
        for name, unit in limit.names.items()
        if name in names
    }


class Hangar:
    """Where a scenario's vehicles come from, all airborne and in Guided.

    `make_coprocessor` builds the co-processor on a sonar bus for a system id: the native core by
    default.
    With `out`, telemetry logs are written there.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        *,
        out: Path | None = None,
        make_coprocessor: MakeCoprocessor | None = None,
    ) -> None:
        self.scenario = scenario
        self.seed = seed
        self._out = out
        self._make_coprocessor = make_coprocessor or self._native

    def rng(self, name: str) -> random.Random:
        """A stream of chance of its own, so that adding a source disturbs no other."""
        return random.Random(f"{self.seed} {name}")

    def leader(self) -> SimVehicle:
        """The leader at the origin, heading north."""
        scenario, plan = self.scenario, self.scenario.leader
        body: Body
        if plan.path == "walk":
            body = TrackedBody(walk(plan, scenario.duration_s))
        elif plan.path == "track" and plan.track is not None:
            body = TrackedBody(load_track(plan.track))
        else:
            start = (0.0, 0.0, -plan.altitude_m)
            body = Copter(start, 0.0, tuning=self._tuning(), flying=True)
        drift = self._drift("leader", body)
        wind = self._wind("leader", body)
        return SimVehicle(body, self._autopilot(body, LEADER_ID, {}), drift, wind)

    def follower(
        self, index: int, start_ned_m: Ned, yaw_rad: float, speed_mps: float, listen: Listen
    ) -> SimFollower:
        """Follower number `index` (from 0), with the applet running unless the law is none."""
        scenario = self.scenario
        body = Copter(start_ned_m, yaw_rad, tuning=self._tuning(), flying=True)
        by_receiver = scenario.follower.parameters.get("EK3_SRC1_POSZ") == HEIGHT_BY_RECEIVER
        drift = self._drift(f"follower {index}", body, by_receiver=by_receiver)
        wind = self._wind(f"follower {index}", body)
        follower = SimFollower(
            body,
            self._autopilot(body, FIRST_FOLLOWER_ID + index, self._parameters(index, speed_mps)),
            drift,
            listen=listen,
            make_coprocessor=self._make_coprocessor,
            ear=self.ear(index),
            wire=self.cutters(f"wire {index}", scenario.wire),
            wind=wind,
        )
        self.fit(follower)
        if scenario.applet_file is not None:
            follower.load_applet(scenario.applet_file)
        return follower

    def fit(self, follower: SimFollower) -> None:
        """Let its autopilot read the sensor, if the sonar file says so."""
        sonar = self.scenario.sonar_file
        if sonar.fixed:
            follower.driver = SensorDriver(
                follower.sensor, follower.autopilot, sonar.rangefinder_type, sonar.rate_hz
            )

    def telemetry(self, vehicle: SimVehicle, name: str, radio: RadioSection) -> Telemetry:
        """The vehicle's radio link."""
        down, up = self.cutters(name, radio)
        return Telemetry(
            vehicle.autopilot,
            down=Radio(radio.settings(), self.rng(f"radio down {name}"), down),
            up=Radio(radio.settings(), self.rng(f"radio up {name}"), up),
            log=open_log(self._out, name),
        )

    def cutters(self, name: str, link: LossySection) -> tuple[PacketCutter, PacketCutter]:
        """What a link does to the bytes of either way."""
        loss = link.byte_settings()
        down, up = (self.rng(f"bytes {way} {name}") for way in ("down", "up"))
        return PacketCutter(loss, down), PacketCutter(loss, up)

    def _parameters(self, index: int, speed_mps: float) -> dict[str, float]:
        scenario = self.scenario
        modern = scenario.follower.autopilot_generation() in (Generation.V4_7, Generation.V4_8)
        speed = {"WP_SPD": speed_mps} if modern else {"WPNAV_SPEED": speed_mps * 100.0}
        # Gray's vehicles are flown as they come: the set-up is ours.
        limits = {} if scenario.guidance.gray else _set_up(scenario.follower.autopilot_generation())
        applet: dict[str, float] = {}
        if scenario.law in SPEED_LAWS:
            applet["ECHO_LAW"] = SPEED_LAWS[scenario.law]
        if scenario.law != "none":
            by_sonar = applet_by_sonar(scenario.sonar_belief)
            applet |= {"ECHO_ENABLE": 1.0, **{name: one.value for name, one in by_sonar.items()}}
            applet |= scenario.applet
            echo_dist_m = scenario.echo_dist_m(index)
            applet |= {} if echo_dist_m is None else {"ECHO_DIST": echo_dist_m}
        return {
            "RNGFND1_TYPE": float(scenario.sonar_file.rangefinder_type),
            "RNGFND1_ORIENT": 0.0,
            "SCR_ENABLE": 1.0,
            **speed,
            **limits,
            **applet,
            **scenario.follower.parameters,
        }

    def _autopilot(self, body: Body, system_id: int, parameters: Mapping[str, float]) -> Autopilot:
        return Autopilot(
            body,
            system_id=system_id,
            generation=self.scenario.follower.autopilot_generation(),
            parameters=parameters,
            seed=self.seed,
        )

    def _tuning(self) -> Tuning:
        """ArduCopter's defaults on SITL's quad, with the scenario's airframe.

        Of the drag the rotors' share goes with the root of the mass, the body's with the mass.
        """
        usual = tuning_of(self.scenario.follower.autopilot_generation())
        frame = self.scenario.airframe
        return replace(
            usual,
            drag_per_s=usual.drag_per_s * frame.drag / math.sqrt(frame.mass),
            drag_per_m=usual.drag_per_m * frame.drag / frame.mass,
            rate_s=usual.rate_s * frame.lag,
            thrust_lag_s=usual.thrust_lag_s * frame.lag,
            velocity_p=usual.velocity_p * frame.gain,
            velocity_i=usual.velocity_i * frame.gain,
            velocity_d=usual.velocity_d * frame.gain,
        )

    def _native(self, bus: Any, system_id: int) -> NativeCoprocessor:
        parameters = board_parameters(system_id, self.scenario)
        return NativeCoprocessor(bus, seed=self.seed, parameters=parameters)

    def _wind(self, name: str, body: Body) -> Wind | None:
        """The wind at a copter, in which it has long hovered; None without wind."""
        plan = self.scenario.wind
        if plan.speed_mps == 0.0 or not isinstance(body, Copter):
            return None
        height_m = self.scenario.leader.altitude_m
        direction_rad = math.radians(plan.direction_deg)
        rng = self.rng(f"wind {name}")
        wind = Wind(plan.speed_mps, direction_rad, plan.turbulence, height_m, rng)
        body.wind_ned_mps = wind.velocity_ned_mps
        body.settle()
        return wind

    def ear(self, index: int) -> Ear:
        """A follower's sonar, as it is in this flight."""
        chance = self._streams(f"sonar {index}")
        return Ear(chance, true_sonar(self.scenario.sonar_file, self.scenario.sonar, chance))

    def _drift(
        self, name: str, body: Body, *, parked: bool = False, by_receiver: bool = False
    ) -> Drift:
        """What the vehicle errs by; the body believes it before its autopilot starts to hold."""
        chance = self._streams(f"gps {name}")
        errors = true_errors(self.scenario.gps, chance)
        drift = Drift(errors, chance, parked=parked, by_receiver=by_receiver)
        body.set_estimate_offset(drift.step(0.0))
        return drift

    def _streams(self, owner: str) -> Callable[[str], random.Random]:
        return lambda name: self.rng(f"{owner} {name}".rstrip())
