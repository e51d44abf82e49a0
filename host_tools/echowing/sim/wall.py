"""The wall flight (thesis 4.2.2): a follower alone, told to fly to a point behind a wall."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.flight import Flight
from echowing.geo import displace
from echowing.mavlink.messages import TOOL_COMPONENT_ID, TOOL_SYSTEM_ID, position_target
from echowing.sim.aircraft import MakeCoprocessor, SimFollower
from echowing.sim.flight import STEP_S, STEP_US, STEPS_PER_SAMPLE, speed_parameter_mps
from echowing.sim.ground import Telemetry
from echowing.sim.hangar import FIRST_FOLLOWER_ID, Hangar
from echowing.sim.recorder import Recorder, Sample
from echowing.sim.scenario import Scenario
from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.sim.world.sonar import GROUND, Surface
from echowing.stopping import waiting_interrupts

# Half of an X8 (thesis Table 3: 0.5 m across): nearer than this it has touched the wall.
BODY_RADIUS_M = 0.25
# ECHO_SPD_MAX, the thesis's 5 m/s (Appendix A).
DEFAULT_TOP_SPEED_MPS = 5.0


@dataclass(frozen=True)
class WallResult:
    """How near the follower's centre came to the wall, and the whole way there.

    In `flight` the wall's nearest point stands in for the leader.
    """

    flight: Flight
    closest_m: float
    wall_s: float

    @property
    def touched(self) -> bool:
        """Whether it hit the wall."""
        return self.closest_m <= BODY_RADIUS_M


def fly_at_wall(
    scenario: Scenario,
    seed: int,
    *,
    speed_mps: float | None = None,
    make_coprocessor: MakeCoprocessor | None = None,
) -> WallResult:
    """Fly the scenario's wall flight; `speed_mps` overrides its approach speed.

    The ground repeats the same target at the guidance rate, as it would a leader's slot, so the
    applet's stream watchdog is content and only the sonar can stop the vehicle.
    """
    wall = scenario.wall
    pace_mps = wall.speed_mps if speed_mps is None else speed_mps
    surface = Surface((wall.distance_m, 0.0, 0.0), (-1.0, 0.0, 0.0))

    def listen(follower: SimFollower, t_s: float) -> float | None:
        return follower.ear.ping(t_s, follower.pose(), (), (GROUND, surface))

    started_s = time.perf_counter()
    hangar = Hangar(_at_pace(scenario, pace_mps), seed, make_coprocessor=make_coprocessor)
    follower = hangar.follower(0, (0.0, 0.0, -wall.altitude_m), 0.0, pace_mps, listen)
    link = hangar.telemetry(follower, "follower", scenario.radio.follower)
    send = _target_sender(scenario, link)
    recorder = Recorder(scenario.name, scenario.slots()[0], scenario.law_name, seed)
    closest_m = math.inf
    with waiting_interrupts() as raise_asked:
        for step in range(1, round(scenario.duration_s / STEP_S) + 1):
            t_s = step * STEP_S
            send(step, t_s)
            link.deliver(t_s)
            follower.move(STEP_S)
            follower.run_coprocessor(step * STEP_US, STEP_S)
            follower.autopilot.step(t_s)
            raise_asked()
            link.collect(t_s)
            distance_m = wall.distance_m - follower.body.north_m
            closest_m = min(closest_m, distance_m)
            if step % STEPS_PER_SAMPLE == 0:
                recorder.samples.append(_sample(follower, t_s, wall.distance_m))
            if distance_m <= BODY_RADIUS_M:
                break
    wall_s = time.perf_counter() - started_s
    return WallResult(recorder.flight(), closest_m, wall_s)


def _at_pace(scenario: Scenario, pace_mps: float) -> Scenario:
    """The scenario with the applet told to approach at this speed while it sees nothing."""
    speeds = {"ECHO_SPD_INIT": pace_mps, "ECHO_SPD_LOST": pace_mps}
    speeds["ECHO_SPD_MAX"] = max(DEFAULT_TOP_SPEED_MPS, pace_mps)
    return scenario.model_copy(update={"applet": {**speeds, **scenario.applet}})


def _target_sender(scenario: Scenario, link: Telemetry) -> Callable[[int, float], None]:
    """Sends the target behind the wall at the guidance rate."""
    wall = scenario.wall
    target = displace(ORIGIN, (wall.distance_m + wall.target_behind_m, 0.0, 0.0))
    mav = mavlink.MAVLink(None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID)
    every = round(1.0 / scenario.guidance.rate_hz / STEP_S)

    def send(step: int, t_s: float) -> None:
        if step % every == 0:
            message = position_target(FIRST_FOLLOWER_ID, target, wall.altitude_m, 0.0, t_s)
            link.send(t_s, bytes(message.pack(mav)))

    return send


def _sample(follower: SimFollower, t_s: float, wall_m: float) -> Sample:
    body = follower.body
    return Sample(
        time_s=t_s,
        leader=(wall_m, body.east_m, body.down_m),
        leader_velocity=(0.0, 0.0, 0.0),
        leader_course_rad=0.0,
        follower=follower.position_ned_m,
        follower_velocity=follower.velocity_ned_mps,
        follower_yaw_rad=body.yaw_rad,
        sonar_m=follower.sensor.last_range_m,
        speed_command_mps=speed_parameter_mps(follower.autopilot),
        pan_us=follower.coprocessor.pan_us,
        tilt_us=follower.coprocessor.tilt_us,
    )


def highest_stopping_speed_mps(scenario: Scenario, seed: int, limit_mps: float = 8.0) -> float:
    """The highest approach speed, in steps of 0.25 m/s, up to which the wall is never touched."""
    stopped_mps, step_mps = 0.0, 0.25
    for number in range(1, round(limit_mps / step_mps) + 1):
        if fly_at_wall(scenario, seed, speed_mps=number * step_mps).touched:
            break
        stopped_mps = number * step_mps
    return stopped_mps
