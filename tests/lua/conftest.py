"""A vehicle on the desk with the applet itself running on it, in both parameter generations."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

from echowing.mavlink.messages import POINT_FORMAT, Manner
from echowing.paths import lua_folder
from echowing.sim.vehicle.desk import GOOD, NO_DATA, DeskVehicle, restarted
from echowing.sim.vehicle.luahost import LuaHost
from echowing.sim.vehicle.parameters import Generation
from echowing.sim.vehicle.rangefinder import MAVLINK_TYPE

PILOT_MPS = 10.0
STEP_MS = 10
METRES_PER_E7 = 0.011131884502145034  # 1e-7 degrees of latitude
HERE = (39.34, -86.03, 260.0)
POSITION_ONLY = 0x0DF8
POSITION_VELOCITY = 0x0DC0
ACCELERATION_IGNORED = 0x01C0
YAW_IGNORED = 0x0400
GROUND_TOOL, CO_PROCESSOR = 245, 1


@dataclass(frozen=True)
class Names:
    """What differs between the generations."""

    generation: Generation
    speed: str
    units_per_mps: float
    system_id: str


OLD = Names(Generation.V4_6, "WPNAV_SPEED", 100.0, "SYSID_THISMAV")
NEW = Names(Generation.V4_8, "WP_SPD", 1.0, "MAV_SYSID")


def mavlink_frame(
    message_id: int, payload: bytes, system: int, *, component: int = 191, old: bool = False
) -> bytes:
    """A whole frame as a radio or wire brings it; old: MAVLink 1, with its zeros at the end."""
    if old:
        head = bytes([len(payload), 0, system, component, message_id])
    else:
        payload = payload.rstrip(b"\0") or b"\0"
        head = bytes([len(payload), 0, 0, 0, system, component])
        head += message_id.to_bytes(3, "little")
    extra = mavlink.mavlink_map[message_id].crc_extra
    checksum: int = x25crc(head + payload + bytes([extra])).crc
    start = b"\xfe" if old else b"\xfd"
    return start + head + payload + checksum.to_bytes(2, "little")


class Rig:
    """The applet on a vehicle; time goes on in steps of 10 ms."""

    def __init__(self, names: Names, script: Path | None = None, **applet: float) -> None:
        self.names = names
        self.script = script or lua_folder() / "echowing.lua"
        firmware = {
            names.speed: PILOT_MPS * names.units_per_mps,
            names.system_id: 1.0,
            "RNGFND1_TYPE": 10.0,
            "RNGFND1_ORIENT": 0.0,
        }
        # The laws' tests count from the sonar's face: a range is the distance. See test_hold.
        self.vehicle = DeskVehicle({**firmware, "ECHO_ENABLE": 1.0, "ECHO_INSET": 0.0})
        for name, value in applet.items():
            self.vehicle.parameters[f"ECHO_{name}"] = value
        self.vehicle.place = HERE
        self.stream_every_ms: int | None = None
        self.raw_every_ms: int | None = None
        self.ahead_m = 5.0
        # The hold takes points with a velocity only; without one they are the speed applet's.
        self.stream_mps = 0.0 if self.script.name == "echowing.lua" else None
        self.raw_m = 3.0
        self.host = self.new_host()

    def new_host(self) -> LuaHost:
        return LuaHost(self.vehicle, self.script, generation=self.names.generation)

    def restart_script(self) -> None:
        self.host = self.new_host()

    def reboot(self) -> None:
        """Parameters come back as saved: the pilot's, and what scripts saved."""
        firmware = {
            name: value
            for name, value in self.vehicle.parameters.items()
            if not name.startswith("ECHO_")
        }
        firmware[self.names.speed] = PILOT_MPS * self.names.units_per_mps
        own = {"ECHO_ENABLE": 1.0, "ECHO_INSET": self.vehicle.parameters["ECHO_INSET"]}
        self.vehicle = restarted(self.vehicle, {**firmware, **own})
        self.restart_script()

    def run(self, seconds: float) -> Rig:
        for _ in range(round(seconds * 1000 / STEP_MS)):
            self.step()
        return self

    def step(self) -> None:
        vehicle = self.vehicle
        vehicle.t_ms += STEP_MS
        if self.stream_every_ms and vehicle.t_ms % self.stream_every_ms == 0:
            self.send_target(self.ahead_m, self.stream_mps)
        if self.raw_every_ms and vehicle.t_ms % self.raw_every_ms == 0:
            vehicle.range_read_ms = vehicle.t_ms
            if vehicle.range_type == MAVLINK_TYPE:
                self.send_raw(self.raw_m)
        self.host.step(vehicle.t_ms)
        assert self.host.error is None, self.host.error

    def range(self, metres: float, status: int = GOOD) -> Rig:
        """What the rangefinder shows from now on; the single readings say the same."""
        self.vehicle.ranges[0] = (status, metres)
        self.raw_m = metres
        return self

    def no_data(self) -> Rig:
        self.raw_every_ms = None
        return self.range(0.0, NO_DATA)

    def send_raw(
        self,
        metres: float,
        *,
        system: int = CO_PROCESSOR,
        name: bytes = b"SNR_RAW",
        board_ms: int | None = None,
    ) -> None:
        """A single reading; board_ms: when the co-processor read it, by its own clock."""
        stamp_ms = self.vehicle.t_ms if board_ms is None else board_ms
        payload = struct.pack("<If10s", stamp_ms, metres, name)
        self.vehicle.inbox.append((mavlink_frame(251, payload, system), 1))

    def send_target(
        self,
        ahead_m: float,
        velocity_mps: float | None = None,
        *,
        aside_m: float = 0.0,
        aside_mps: float = 0.0,
        up_m: float = 10.0,
        yaw_rad: float | None = None,
        system: int = 1,
        opens_m: float = 0.0,
        manner: Manner = Manner.HOLD,
        quickens_mps2: float = 0.0,
        ignored: int = ACCELERATION_IGNORED,
        form: float = POINT_FORMAT,
        sender: int = GROUND_TOOL,
    ) -> None:
        """A guided point so far north and east of HERE, with or without a velocity (there, too).

        up_m: above home; yaw_rad: None: the autopilot's choice; opens_m: the distance to keep;
        manner: how it is to be flown; quickens_mps2: by how much to speed up; form: the format of
        these, in ignored fields.
        """
        lat = round(HERE[0] * 1e7 + ahead_m / METRES_PER_E7)
        metres_per_e7 = METRES_PER_E7 * math.cos(math.radians(HERE[0]))
        lng = round(HERE[1] * 1e7 + aside_m / metres_per_e7)
        mask = POSITION_ONLY if velocity_mps is None else POSITION_VELOCITY
        mask &= ~(ACCELERATION_IGNORED & ~ignored)
        if yaw_rad is not None:
            mask &= ~YAW_IGNORED
        velocity = (0.0, 0.0) if velocity_mps is None else (velocity_mps, aside_mps)
        place, turns = (lat, lng, up_m), (yaw_rad or 0.0, quickens_mps2)
        fields = (*place, *velocity, 0.0, opens_m, manner, form, *turns, mask, system, 1, 6)
        payload = struct.pack("<Iii9fHBBB", self.vehicle.t_ms, *fields)
        self.vehicle.inbox.append((mavlink_frame(86, payload, sender), 0))

    @property
    def speed_mps(self) -> float:
        """The limit last given to the vehicle."""
        return self.vehicle.desired_speeds[-1]

    @property
    def parameter_mps(self) -> float:
        """The speed parameter in m/s."""
        return self.vehicle.parameters[self.names.speed] / self.names.units_per_mps

    @property
    def mirror_mps(self) -> float:
        return self.vehicle.parameters["ECHO_MIRROR"] / self.names.units_per_mps

    @property
    def texts(self) -> list[str]:
        return [text.removeprefix("ECHO: ") for _, text in self.vehicle.texts]

    @property
    def state(self) -> float:
        return self.vehicle.named["ECHO_STATE"][-1]

    def target_ahead_m(self) -> float:
        """How far ahead (north) the applet's last own target lies."""
        kind, target = self.vehicle.targets[-1]
        assert kind in ("position", "posvel")
        assert isinstance(target[0], float)
        assert self.vehicle.position is not None
        return target[0] - self.vehicle.position[0]


MakeRig = Callable[..., Rig]


@pytest.fixture(params=[OLD, NEW], ids=["WPNAV_SPEED", "WP_SPD"])
def names(request: pytest.FixtureRequest) -> Names:
    found: Names = request.param
    return found


@pytest.fixture
def rig(names: Names) -> MakeRig:
    """Makes a rig: `rig(LAW=2)` with those applet parameters."""

    def make(script: Path | None = None, **applet: float) -> Rig:
        return Rig(names, script, **applet)

    return make
