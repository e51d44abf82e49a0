"""Vehicles in a yard that answer as an autopilot with the applet does, and a session among them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.belief import SonarBelief
from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.readiness import Readiness
from echowing.flight.session import FollowSession
from echowing.geo import GlobalPosition, displace
from echowing.mavlink.messages import POINT_FORMAT
from echowing.mavlink.plausible import Door
from echowing.mavlink.vehicle_limits import usual_parameters
from echowing.sonar_file import shipped_sonar
from echowing.tool.panel import state_of

LEADER, FOLLOWER, SECOND = 1, 2, 3
HERE = GlobalPosition(39.34, -86.03, 250.0)
POINT = "SET_POSITION_TARGET_GLOBAL_INT"
TICK_S = 0.125
AUTO = mavlink.COPTER_MODE_AUTO
GUIDED, LOITER = mavlink.COPTER_MODE_GUIDED, mavlink.COPTER_MODE_LOITER
SETTLED_EKF = 831  # of a vehicle in the air with a GPS


@dataclass
class Vehicle:
    """One vehicle: where it is and what it says.

    boot_s: when it was switched on; late_s: how old its positions are when they come; says_clock:
    whether it answers TIMESYNC; pitch_rad: how it leans, its nose to the north; parameters: what
    it answers to a question for them; stuck: its reports keep the place of that one.
    """

    at_m: tuple[float, float]
    velocity_mps: tuple[float, float] = (0.0, 0.0)
    height_m: float = 10.0
    home_m: float = 250.0
    boot_s: float = -100.0
    late_s: float = 0.0
    says_clock: bool = True
    fix_type: int = mavlink.GPS_FIX_TYPE_3D_FIX
    satellites: int = 10
    hdop: float = 0.8
    ekf_flags: int = SETTLED_EKF
    ekf_variance: float = 0.05
    battery_percent: int = 80
    mode: int = GUIDED
    pitch_rad: float = 0.0
    silent: bool = False
    stuck: Any = None
    parameters: dict[str, float] = field(
        default_factory=lambda: {
            "ECHO_ENABLE": 1.0,
            "ECHO_FORMAT": POINT_FORMAT,
            "ECHO_DIST": 3.0,
            "ECHO_INSET": 0.2,
            "ECHO_DETECT": 4.5,
            "ECHO_STREAM_T": 1.0,
            **usual_parameters(),
            "WP_ACC": 5.0,
            "PSC_JERK_NE": 20.0,
        }
    )

    def boot_ms(self, now_s: float) -> int:
        return round((now_s - self.boot_s) * 1e3)

    def position(self, now_s: float) -> Any:
        at = displace(HERE, (*self.at_m, 0.0))
        north_mps, east_mps = self.velocity_mps
        return mavlink.MAVLink_global_position_int_message(
            self.boot_ms(now_s - self.late_s),
            round(at.lat_deg * 1e7),
            round(at.lon_deg * 1e7),
            round((self.home_m + self.height_m) * 1e3),
            round(self.height_m * 1e3),
            round(north_mps * 100),
            round(east_mps * 100),
            0,
            0,
        )

    def heartbeat(self) -> Any:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return mavlink.MAVLink_heartbeat_message(2, 3, flags, self.mode, 4, 3)

    def reports(self, now_s: float) -> list[Any]:
        """What it says once a second."""
        return [
            self.heartbeat(),
            mavlink.MAVLink_attitude_message(
                self.boot_ms(now_s), 0.0, self.pitch_rad, 0.0, 0.0, 0.0, 0.0
            ),
            mavlink.MAVLink_gps_raw_int_message(
                *(0, self.fix_type, 0, 0, 0, round(self.hdop * 100)),
                *(0, 0, 0, self.satellites),
            ),
            mavlink.MAVLink_ekf_status_report_message(
                self.ekf_flags, 0.05, self.ekf_variance, *(0.05,) * 3
            ),
            mavlink.MAVLink_sys_status_message(
                0, 0, 0, 0, 12_600, 0, self.battery_percent, *(0,) * 6
            ),
        ]

    def answer(self, message: Any, now_s: float) -> list[Any]:
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0 and self.says_clock:
            stamp_ns = round((now_s - self.boot_s) * 1e9)
            return [mavlink.MAVLink_timesync_message(stamp_ns, message.ts1)]
        if kind == "PARAM_REQUEST_READ":
            name = message.param_id
            name = name.decode() if isinstance(name, bytes) else name
            if name in self.parameters:
                real = mavlink.MAV_PARAM_TYPE_REAL32
                value = self.parameters[name]
                return [mavlink.MAVLink_param_value_message(name.encode(), value, real, 1, 0)]
        return []


class Yard:
    """A leader that heads north, followers, and a session that hears them at every tick."""

    def __init__(
        self,
        *,
        vehicles: dict[int, Vehicle] | None = None,
        slots: Sequence[Slot] = (Slot(3.0),),
        limits: Limits | None = None,
        ready: Readiness | None = None,
        engaged: bool = True,
        leaders_height: bool = False,
        settings: GuidanceSettings | None = None,
        sonar: SonarBelief | None = None,
    ) -> None:
        self.vehicles = vehicles or {LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((-4.0, 0.0))}
        self.now_s = 0.0
        self.door = Door()
        followers = [system_id for system_id in self.vehicles if system_id != LEADER]
        limits = limits or Limits(home_difference_m=5.0)
        self.session = FollowSession(
            LEADER,
            [
                FollowerPlan(i, slot, 10.0, sonar=sonar or shipped_sonar())
                for i, slot in zip(followers, slots, strict=True)
            ],
            settings or GuidanceSettings(learn_offset=False),
            limits=replace(limits, ready=ready or Readiness()),
            engaged=engaged,
            leaders_height=leaders_height,
        )
        self.sent: list[tuple[int, Any]] = []

    def tell(self, system_id: int, message: Any, component: int = 1) -> None:
        sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
        parsed = mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))
        if self.door.admits(parsed):
            self.session.receive(parsed, self.now_s)

    def fly(self, seconds: float) -> list[Any]:
        """Let time pass; returns the points that were sent."""
        points = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            for system_id, vehicle in self.vehicles.items():
                self._report(system_id, vehicle)
            sent = self.session.tick(self.now_s)
            self.sent += sent
            for system_id, message in sent:
                for answer in self.vehicles[system_id].answer(message, self.now_s):
                    self.tell(system_id, answer)
            points += [message for _, message in sent if message.get_type() == POINT]
        return points

    def _report(self, system_id: int, vehicle: Vehicle) -> None:
        north_m, east_m = vehicle.at_m
        north_mps, east_mps = vehicle.velocity_mps
        vehicle.at_m = north_m + north_mps * TICK_S, east_m + east_mps * TICK_S
        if vehicle.silent:
            return
        place = vehicle.position(self.now_s)
        if vehicle.stuck is not None:
            place.lat, place.lon = vehicle.stuck.lat, vehicle.stuck.lon
        self.tell(system_id, place)
        if math.isclose(self.now_s % 1.0, TICK_S):
            for message in vehicle.reports(self.now_s):
                self.tell(system_id, message)

    def events(self) -> list[str]:
        return [text for _, text in self.session.events]

    def said(self, text: str) -> bool:
        return any(text in event for event in self.events())

    def state(self, system_id: int = FOLLOWER) -> str:
        return state_of(self.session.followers[system_id])
