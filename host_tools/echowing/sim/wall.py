"""The wall flight (thesis 4.2.2): a follower alone, told to fly to a point behind a wall."""

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.follow import TOOL_COMPONENT_ID, TOOL_SYSTEM_ID, position_target
from echowing.geo import displace
from echowing.sim.autopilot import ORIGIN
from echowing.sim.flight import STEP_S, STEP_US
from echowing.sim.hangar import FIRST_FOLLOWER_ID, Hangar
from echowing.sim.scenario import Scenario
from echowing.sim.sonar import GROUND, Surface
from echowing.sim.vehicles import MakeCoprocessor, SimFollower

# Half of an X8 (thesis Table 3: 0.5 m across): nearer than this it has touched the wall.
BODY_RADIUS_M = 0.25


@dataclass(frozen=True)
class WallResult:
    """How near the follower came, and where it was at the end; distances of its centre."""

    law: str
    speed_mps: float
    closest_m: float
    final_m: float
    time_s: list[float]
    distance_m: list[float]
    ground_speed_mps: list[float]

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

    hangar = Hangar(scenario, seed, make_coprocessor=make_coprocessor)
    follower = hangar.follower(0, (0.0, 0.0, -wall.altitude_m), 0.0, pace_mps, listen)
    link = hangar.telemetry(follower, "follower", scenario.radio.follower)
    result = WallResult(scenario.law, pace_mps, math.inf, math.inf, [], [], [])
    target = displace(ORIGIN, (wall.distance_m + wall.target_behind_m, 0.0, 0.0))
    mav = mavlink.MAVLink(None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID)
    period_steps = round(1.0 / scenario.guidance.rate_hz / STEP_S)
    closest_m = math.inf
    for step in range(round(scenario.duration_s / STEP_S)):
        t_s = step * STEP_S
        if step % period_steps == 0:
            message = position_target(FIRST_FOLLOWER_ID, target, wall.altitude_m, 0.0, t_s)
            link.send(t_s, bytes(message.pack(mav)))
        link.deliver(t_s)
        follower.move(STEP_S)
        follower.run_coprocessor((step + 1) * STEP_US, STEP_S)
        follower.autopilot.step(t_s)
        link.collect(t_s)
        distance_m = wall.distance_m - follower.body.north_m
        closest_m = min(closest_m, distance_m)
        if step % 5 == 0:
            result.time_s.append(t_s)
            result.distance_m.append(distance_m)
            result.ground_speed_mps.append(math.hypot(*follower.velocity_ned_mps[:2]))
        if distance_m <= BODY_RADIUS_M:
            break
    return WallResult(
        scenario.law,
        pace_mps,
        closest_m,
        distance_m,
        result.time_s,
        result.distance_m,
        result.ground_speed_mps,
    )


def highest_stopping_speed_mps(scenario: Scenario, seed: int, limit_mps: float = 8.0) -> float:
    """The highest approach speed, in steps of 0.25 m/s, up to which the wall is never touched."""
    stopped_mps, step_mps = 0.0, 0.25
    for number in range(1, round(limit_mps / step_mps) + 1):
        if fly_at_wall(scenario, seed, speed_mps=number * step_mps).touched:
            break
        stopped_mps = number * step_mps
    return stopped_mps
