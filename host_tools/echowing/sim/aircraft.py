"""The vehicles of a simulated flight: body, autopilot, receiver, and the follower's sonar rig."""

import math
from collections.abc import Callable
from pathlib import Path

from echowing.geo import Ned
from echowing.sim.boards.coprocessor import Coprocessor, SonarBus
from echowing.sim.scenario import LeaderEvent, LeaderSection
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sim.vehicle.rangefinder import MAXBOTIX_TYPE
from echowing.sim.world.cutter import PacketCutter
from echowing.sim.world.gps import Drift
from echowing.sim.world.leader import TrackedBody, mission
from echowing.sim.world.sonar import (
    COMMAND_RANGE,
    Ear,
    Gimbal,
    MaxSonar,
    Pose,
    Target,
    body_to_ned,
)
from echowing.sim.world.wind import Wind

COPROCESSOR = "coprocessor"
AUTOPILOT_PORT = 0
# The sonar looks again on every world step, so a body's pose is at most this old in a ping.
STEP_US = 20_000

Body = Copter | TrackedBody
# On a sonar bus, for the vehicle of that system id.
MakeCoprocessor = Callable[[SonarBus, int], Coprocessor]


class SimVehicle:
    """A body in the air with an autopilot whose estimate drifts, in wind if there is."""

    def __init__(
        self, body: Body, autopilot: Autopilot, drift: Drift, wind: Wind | None = None
    ) -> None:
        self.body = body
        self.autopilot = autopilot
        self.drift = drift
        self._wind = wind

    @property
    def position_ned_m(self) -> Ned:
        """True position."""
        return self.body.north_m, self.body.east_m, self.body.down_m

    @property
    def velocity_ned_mps(self) -> Ned:
        """True velocity."""
        return self.body.vn_mps, self.body.ve_mps, self.body.vd_mps

    def move(self, dt_s: float) -> None:
        """Receiver, wind and body, one step on."""
        drift = self.drift
        self.autopilot.set_errors(drift.step(dt_s), drift.velocity_mps, drift.receiver_down_m)
        self.body.estimate_reset(drift.taken_reset())
        if self._wind is not None and isinstance(self.body, Copter):
            self.body.wind_ned_mps = self._wind.step(dt_s)
        self.body.step(dt_s)


class _LaterBus:
    """The sonar on the bus of a board that was switched on later than the flight began."""

    def __init__(self, bus: SonarBus, since_us: int) -> None:
        self._bus = bus
        self._since_us = since_us

    def write(self, t_us: int, address: int, data: bytes) -> bool:
        """As `SonarBus.write`."""
        return self._bus.write(self._since_us + t_us, address, data)

    def read(self, t_us: int, address: int, count: int) -> bytes | None:
        """As `SonarBus.read`."""
        return self._bus.read(self._since_us + t_us, address, count)


class SensorDriver:
    """The autopilot's own driver of a sensor on its bus, as AP_RangeFinder_MaxsonarI2CXL.cpp.

    A MaxBotix is read a period after its ping; what another one reads is there at once.

    kind: the RNGFNDn_TYPE that the autopilot reads this sensor with.
    """

    def __init__(self, sensor: MaxSonar, autopilot: Autopilot, kind: int, rate_hz: float) -> None:
        self._sensor, self._autopilot, self._kind = sensor, autopilot, kind
        self._period_us, self._due_us = round(1e6 / rate_hz), 0

    def step(self, t_us: int) -> None:
        """Read, when it is time."""
        rangefinder, address = self._autopilot.rangefinder, self._sensor.address
        rangefinder.driven = rangefinder.type == self._kind  # each start makes a new one
        if t_us < self._due_us:
            return
        self._due_us += self._period_us
        if not rangefinder.driven:
            return
        if rangefinder.type != MAXBOTIX_TYPE:
            self._ping(t_us)
            range_m = self._sensor.last_range_m
            if self._sensor.plugged:
                far_m = rangefinder.max_m() + 1.0
                reported_m = far_m if range_m is None else range_m
                rangefinder.read(round(100.0 * reported_m), self._autopilot.millis())
            return
        data = self._sensor.read(t_us, address, 2)
        self._ping(t_us)
        if data is not None:
            rangefinder.read(int.from_bytes(data, "big"), self._autopilot.millis())

    def _ping(self, t_us: int) -> None:
        self._sensor.write(t_us, self._sensor.address, bytes([COMMAND_RANGE]))


class SimFollower(SimVehicle):
    """A follower: the vehicle, with gimbal, sonar and co-processor on it.

    driver: of a sensor that its autopilot reads itself; then co-processor and gimbal are not there.

    Faults: `hears` makes something else of what the sonar hears; `reflector_m`: so far ahead is
    something loud; `beam_half_angle_rad`: its beam is nowhere wider. `wire`: how the bytes fare
    between autopilot and co-processor, to it and from it.
    """

    def __init__(
        self,
        body: Body,
        autopilot: Autopilot,
        drift: Drift,
        *,
        listen: Callable[["SimFollower", float], float | None],
        make_coprocessor: MakeCoprocessor,
        ear: Ear,
        wire: tuple[PacketCutter, PacketCutter],
        wind: Wind | None = None,
    ) -> None:
        super().__init__(body, autopilot, drift, wind)
        self.wire_down, self.wire_up = wire
        self.gimbal = Gimbal()
        self.ear = ear
        self.hears: Callable[[float | None], float | None] | None = None
        self.reflector_m: float | None = None
        self.beam_half_angle_rad = ear.sonar.widest_rad
        self.sensor = MaxSonar(lambda t_s: listen(self, t_s))
        self._make_coprocessor = make_coprocessor
        self._powered = True
        self._powered_since_us = 0
        self.coprocessor = make_coprocessor(self.sensor, autopilot.system_id)
        self.driver: SensorDriver | None = None
        autopilot.add_link(COPROCESSOR)

    def pose(self) -> Pose:
        """Where the sonar is and looks, now."""
        body = self.body
        angles = body.roll_rad, body.pitch_rad, body.yaw_rad
        axis = body_to_ned(self.gimbal.axis_body(), *angles)
        throttle = body.throttle if isinstance(body, Copter) else 0.0
        north, east, down = self.position_ned_m
        boom_m = self.ear.sonar.boom_m
        if boom_m:
            dn, de, dd = body_to_ned((boom_m, 0.0, 0.0), *angles)
            north, east, down = north + dn, east + de, down + dd
        return Pose((north, east, down), axis, self.beam_half_angle_rad, throttle)

    def reflector(self, pose: Pose) -> list[Target]:
        """What is loud ahead, if anything is."""
        if self.reflector_m is None:
            return []
        (x, y, z), (ax, ay, az) = pose.position_ned_m, pose.axis_ned
        far_m = self.reflector_m
        return [Target((x + far_m * ax, y + far_m * ay, z + far_m * az), math.inf)]

    def heard(self, range_m: float | None) -> float | None:
        """What the sonar makes of an echo."""
        return range_m if self.hears is None else self.hears(range_m)

    def stop_coprocessor(self) -> None:
        """Cut its supply: without pulses the servos stay where they are."""
        self._powered = False

    def start_coprocessor(self, t_s: float) -> None:
        """Switch it on anew: it has forgotten all but its stored parameters."""
        self._powered = True
        self._powered_since_us = round(t_s * 1e6)
        bus = _LaterBus(self.sensor, self._powered_since_us)
        self.coprocessor = self._make_coprocessor(bus, self.autopilot.system_id)

    def run_coprocessor(self, t_us: int, dt_s: float) -> None:
        """The co-processor and the wire between it and the autopilot, one step on."""
        coprocessor = self.coprocessor
        down = self.autopilot.transmit(COPROCESSOR)
        if self.driver is not None:
            self.driver.step(t_us)
            return
        if not self._powered:
            return
        self.gimbal.step(dt_s, coprocessor.pan_us, coprocessor.tilt_us)
        if down:
            coprocessor.feed(AUTOPILOT_PORT, self.wire_down.carry(down, t_us / 1e6))
        coprocessor.run_until(t_us - self._powered_since_us)
        up = coprocessor.take(AUTOPILOT_PORT)
        if up:
            self.autopilot.receive(COPROCESSOR, self.wire_up.carry(up, t_us / 1e6))

    def load_applet(self, path: Path) -> None:
        """Put the applet on this vehicle's SD card and start it."""
        self.autopilot.load_script(path)


class LeaderPilot:
    """Flies the leader: starts its mission, or acts out a script."""

    # A stop-and-go leader waits this long at each corner.
    WAIT_S = 6.0
    ARRIVED_M, STILL_MPS = 1.0, 0.1

    def __init__(self, leader: SimVehicle, plan: LeaderSection) -> None:
        self._leader = leader
        self._plan = plan
        self._script = list(plan.script)
        self._legs = mission(plan) if plan.path == "stop-and-go" else []
        self._started = False
        self._still_since_s: float | None = None
        self.event: LeaderEvent | None = None
        self._interrupting: LeaderEvent | None = None
        self.silent = False
        self._attack: Ned = (0.0, 0.0, 0.0)

    def step(self, t_s: float, follower: Ned) -> None:
        """Act at `t_s`; `follower` is where the first follower truly is (to be flown at)."""
        if self._plan.path in ("walk", "track"):
            return
        if self._interrupting is not None:
            self._go_on(self._interrupting)
        elif self._plan.path == "script":
            self._act(t_s, follower)
        elif self._plan.path == "stop-and-go":
            self._next_leg(t_s)
        elif not self._started and t_s >= self._plan.start_s:
            self._started = True
            self._leader.autopilot.start_mission(mission(self._plan), self._plan.speed_mps)

    def _next_leg(self, t_s: float) -> None:
        if t_s < self._plan.start_s or not self._legs or not self._waited(t_s):
            return
        self._leader.autopilot.start_mission([self._legs.pop(0)], self._plan.speed_mps)
        self._still_since_s = None

    def _waited(self, t_s: float) -> bool:
        if not self._started:
            self._started = True
            return True
        if math.hypot(*self._leader.velocity_ned_mps[:2]) > self.STILL_MPS:
            self._still_since_s = t_s
        if self._still_since_s is None:
            return False
        return t_s - self._still_since_s >= self.WAIT_S

    def _act(self, t_s: float, follower: Ned) -> None:
        while self._script and t_s >= self._script[0].at_s:
            self.event = self._script.pop(0)
            self._begin(self.event, follower)
        if self.event is not None:
            self._go_on(self.event)

    def _go_on(self, event: LeaderEvent) -> None:
        # A velocity target times out on the autopilot (GUID_TIMEOUT), so it is said again.
        if event.act in ("fly", "hold"):
            self._fly(event.velocity_ned_mps, event.yaw_deg)
        elif event.act == "at_follower":
            self._fly(self._attack, math.degrees(math.atan2(self._attack[1], self._attack[0])))

    def interrupt(self, event: LeaderEvent, follower: Ned) -> None:
        """Leave the path for something else, until `resume`; `follower`: where the first is."""
        self._interrupting = event
        self._begin(event, follower)

    def resume(self) -> None:
        """Go on with the path: a mission from its first waypoint, a script with its last event."""
        self._interrupting = None
        if self._plan.path == "script":
            if self.event is not None:
                self._begin(self.event, self._leader.position_ned_m)
        else:
            self._started = False
            self._still_since_s = None
            self._legs = self._legs or mission(self._plan)

    def _begin(self, event: LeaderEvent, follower: Ned) -> None:
        leader = self._leader
        if event.act == "auto":
            leader.autopilot.start_mission(mission(self._plan), self._plan.speed_mps)
        elif event.act == "goto":
            leader.autopilot.start_mission([event.point_ned_m], event.speed_mps)
        elif event.act == "gps_jump":
            leader.drift.jump_to(event.jump_ned_m)
        elif event.act == "silent":
            self.silent = True
        elif event.act == "heard":
            self.silent = False
            leader.drift.jump_to((0.0, 0.0, 0.0))
        else:
            self._attack = self._attack_on(follower, event.speed_mps)
            leader.autopilot.set_mode("GUIDED")

    def _attack_on(self, follower: Ned, speed_mps: float) -> Ned:
        """The velocity straight at where the follower is now."""
        here = self._leader.position_ned_m
        north, east = follower[0] - here[0], follower[1] - here[1]
        pace = speed_mps / max(math.hypot(north, east), 1e-6)
        return north * pace, east * pace, 0.0

    def _fly(self, velocity: Ned, yaw_deg: float | None) -> None:
        yaw_rad = None if yaw_deg is None else math.radians(yaw_deg)
        body = self._leader.body
        if isinstance(body, Copter):
            body.guided_velocity(velocity, yaw_rad)
