"""A simulated autopilot with a ground station's MAVLink on the bench, in lock step."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import GlobalPosition, displace
from echowing.sim.vehicle.autopilot import ORIGIN, Autopilot
from echowing.sim.vehicle.copter import Copter
from echowing.sim.vehicle.parameters import Generation

STEP_S = 0.02
SYSTEM_ID = 7
TOOL = (245, 190)
POSITION_ONLY = 0x0DF8 | 0x200  # velocity, acceleration, yaw, yaw rate ignored; force set
POSITION_ONLY_YAW = POSITION_ONLY & ~0x400
POSITION_VELOCITY = 0x0DC0
VELOCITY_ONLY = 0x0DC7
RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
FORWARD_SONAR = {"RNGFND1_TYPE": 10.0, "RNGFND1_ORIENT": 0.0}


class Bench:
    """One vehicle, and what a ground station on `telemetry` and a device on `coprocessor` hear."""

    def __init__(
        self,
        *,
        flying: bool = True,
        generation: Generation = Generation.V4_8,
        parameters: Mapping[str, float] | None = None,
        height_m: float = 10.0,
    ) -> None:
        self.copter = Copter((0.0, 0.0, -height_m if flying else 0.0), flying=flying)
        self.autopilot = Autopilot(
            self.copter, system_id=SYSTEM_ID, generation=generation, parameters=parameters
        )
        self.t_s = 0.0
        self.steps = 0
        self.raw: dict[str, bytearray] = {}
        self._heard: dict[str, list[Any]] = {}
        self._parsers: dict[str, Any] = {}
        self._senders: dict[tuple[int, int], Any] = {}
        for link in ("telemetry", "coprocessor"):
            self.add_link(link)

    def add_link(self, link: str) -> None:
        self.autopilot.add_link(link)
        self._heard[link] = []
        self.raw[link] = bytearray()
        self._parsers[link] = mavlink.MAVLink(None)

    def send(
        self, message: Any, *, link: str = "telemetry", source: tuple[int, int] = TOOL
    ) -> None:
        sender = self._senders.setdefault(source, mavlink.MAVLink(None, *source))
        self.autopilot.receive(link, message.pack(sender))
        sender.seq = (sender.seq + 1) % 256

    def step(self) -> None:
        self.steps += 1
        self.t_s = self.steps * STEP_S
        self.copter.step(STEP_S)
        self.autopilot.step(self.t_s)
        for link, parser in self._parsers.items():
            data = self.autopilot.transmit(link)
            self.raw[link] += data
            self._heard[link] += parser.parse_buffer(data) or []

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        for _ in range(round(seconds / STEP_S)):
            if each is not None:
                each()
            self.step()

    def heard(self, kind: str, link: str = "telemetry") -> list[Any]:
        return [m for m in self._heard[link] if m.get_type() == kind]

    def forget(self) -> None:
        for messages in self._heard.values():
            messages.clear()

    def texts(self, link: str = "telemetry") -> list[str]:
        return [m.text for m in self.heard("STATUSTEXT", link)]

    def command(self, number: int, *values: float) -> int:
        """Send a COMMAND_LONG and return the MAV_RESULT that comes back."""
        padded = (*values, *(0.0,) * (7 - len(values)))
        self.send(mavlink.MAVLink_command_long_message(SYSTEM_ID, 1, number, 0, *padded))
        return self._result(number)

    def command_int(self, number: int, frame: int, *values: float) -> int:
        p1, p2, p3, p4, x, y, z = values
        self.send(
            mavlink.MAVLink_command_int_message(
                SYSTEM_ID, 1, frame, number, 0, 0, p1, p2, p3, p4, int(x), int(y), z
            )
        )
        return self._result(number)

    def _result(self, number: int) -> int:
        before = len(self.heard("COMMAND_ACK"))
        self.step()
        answers = self.heard("COMMAND_ACK")[before:]
        assert [answer.command for answer in answers] == [number]
        assert (answers[0].target_system, answers[0].target_component) == TOOL
        return int(answers[0].result)

    def target(
        self,
        north_m: float,
        east_m: float = 0.0,
        height_m: float = 10.0,
        *,
        mask: int = POSITION_ONLY,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw_rad: float = 0.0,
        frame: int = RELATIVE,
    ) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT to a place by its metres from the origin."""
        place = displace(ORIGIN, (north_m, east_m, 0.0))
        self.raw_target(
            round(place.lat_deg * 1e7),
            round(place.lon_deg * 1e7),
            height_m,
            mask=mask,
            velocity=velocity,
            yaw_rad=yaw_rad,
            frame=frame,
        )

    def raw_target(
        self,
        lat_e7: int,
        lon_e7: int,
        alt_m: float,
        *,
        mask: int = POSITION_ONLY,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw_rad: float = 0.0,
        frame: int = RELATIVE,
    ) -> None:
        self.send(
            mavlink.MAVLink_set_position_target_global_int_message(
                0, SYSTEM_ID, 1, frame, mask, lat_e7, lon_e7, alt_m,
                *velocity, 0.0, 0.0, 0.0, yaw_rad, 0.0,
            )
        )  # fmt: skip

    def local_target(
        self,
        position: tuple[float, float, float],
        *,
        mask: int = POSITION_ONLY,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw_rad: float = 0.0,
        frame: int = mavlink.MAV_FRAME_LOCAL_NED,
    ) -> None:
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, SYSTEM_ID, 1, frame, mask, *position, *velocity, 0.0, 0.0, 0.0, yaw_rad, 0.0
            )
        )

    def sonar(
        self,
        distance_cm: int,
        *,
        orientation: int = 0,
        sensor_id: int = 0,
        limits_cm: tuple[int, int] = (20, 765),
        quality: int = 0,
    ) -> None:
        """DISTANCE_SENSOR from the co-processor."""
        self.send(
            mavlink.MAVLink_distance_sensor_message(
                0, *limits_cm, distance_cm, 1, sensor_id, orientation, 255,
                signal_quality=quality,
            ),
            link="coprocessor",
            source=(SYSTEM_ID, 191),
        )  # fmt: skip

    def position(self) -> GlobalPosition:
        message = self.heard("GLOBAL_POSITION_INT")[-1]
        return GlobalPosition(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3)

    @property
    def speed_mps(self) -> float:
        return math.hypot(self.copter.vn_mps, self.copter.ve_mps)
