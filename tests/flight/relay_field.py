"""A remote vehicle and its relay, both simulated copters, in the session of `echowing relay`."""

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import Limits
from echowing.flight.guidance import Slot
from echowing.flight.readiness import Readiness
from echowing.flight.relay import BESIDE_M, RELAY_SETTINGS, RelayGuide
from echowing.flight.session import FollowSession
from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.sim.vehicle.copter import Copter
from echowing.sonar_file import shipped_sonar

from .yard import HERE, Vehicle

REMOTE, RELAY = 1, 2
STEP_S = 0.02
TICK_S = 0.25  # points at 4 Hz, as `echowing relay` sends them
REPORT_S = {REMOTE: 0.25, RELAY: 0.1}
LATE_S = 0.3  # of every report, as over a telemetry radio
RELAY_MPS = 5.0  # WPNAV_SPEED's default

Fly = Callable[[Copter, float], None]
"""What the remote's pilot does: its copter, and the time."""


def place_of(copter: Copter) -> Ned:
    """Where it truly is."""
    return copter.north_m, copter.east_m, copter.down_m


class RelayField:
    """Flown at STEP_S; the ground station is HERE. offset_m: by what the remote's receiver is off.

    rtl: parameters that the remote answers for. home_m: by how much the relay's home is higher.
    """

    def __init__(
        self,
        remote_m: tuple[float, float],
        fly: Fly,
        *,
        heights_m: tuple[float, float] = (30.0, 30.0),
        offset_m: tuple[float, float] = (0.0, 0.0),
        min_separation_m: float = 10.0,
        apart_m: float | None = None,
        rtl: dict[str, float] | None = None,
        home_m: float = 0.0,
    ) -> None:
        north_m, east_m = remote_m
        starts = {
            REMOTE: (north_m, east_m, -heights_m[0]),
            RELAY: (north_m / 2.0, east_m / 2.0, -heights_m[1]),
        }
        self.copters = {who: Copter(start, flying=True) for who, start in starts.items()}
        for copter in self.copters.values():
            copter.start_guided(RELAY_MPS)
            copter.guided_position(place_of(copter))
        self.vehicles = {who: Vehicle((0.0, 0.0)) for who in starts}
        self.vehicles[REMOTE].parameters = rtl or {}
        self._fly, self._offset_m, self._home_m = fly, offset_m, home_m
        self.session = FollowSession(
            REMOTE,
            [FollowerPlan(RELAY, Slot(0.0), heights_m[1] - home_m, sonar=shipped_sonar())],
            RELAY_SETTINGS,
            limits=Limits(
                max_distance_m=5_000.0,
                min_separation_m=min_separation_m,
                leader_flies=False,
                ready=Readiness(
                    any_applet=True,
                    distance=False,
                    reversal=False,
                    sides=False,
                    height_told=True,
                    apart_m=apart_m,
                ),
            ),
        )
        follower = self.session.followers[RELAY]
        follower.guide = RelayGuide(HERE, min_separation_m + BESIDE_M)
        self.now_s = 0.0
        self.least_m = math.inf
        self.level_m: list[float] = []
        self._late: deque[tuple[float, int, Any]] = deque()
        self._steps = 0

    def fly(self, seconds: float) -> float:
        """Let time pass; returns how near the two have been."""
        for _ in range(round(seconds / STEP_S)):
            self._steps += 1
            self.now_s = self._steps * STEP_S
            self._fly(self.copters[REMOTE], self.now_s)
            for who, copter in self.copters.items():
                copter.step(STEP_S)
                self._report(who, copter)
            self._deliver()
            if self._steps % round(TICK_S / STEP_S) == 0:
                self._tick()
            a, b = (place_of(copter) for copter in self.copters.values())
            self.least_m = min(self.least_m, math.dist(a, b))
            self.level_m.append(math.dist(a[:2], b[:2]))
        return self.least_m

    def _report(self, who: int, copter: Copter) -> None:
        if self.vehicles[who].silent:
            return
        if self._steps % round(REPORT_S[who] / STEP_S) == 0:
            self._late.append((self.now_s + LATE_S, who, self._position(who, copter)))
        if self._steps % round(1.0 / STEP_S) == 0:
            for message in self.vehicles[who].reports(self.now_s):
                self._late.append((self.now_s + LATE_S, who, message))

    def _position(self, who: int, copter: Copter) -> Any:
        north_m, east_m, down_m = place_of(copter)
        if who == REMOTE:
            north_m, east_m = north_m + self._offset_m[0], east_m + self._offset_m[1]
        at = displace(HERE, (north_m, east_m, 0.0))
        home_m = self._home_m if who == RELAY else 0.0
        vn, ve, vd = copter.vn_mps, copter.ve_mps, copter.vd_mps
        return mavlink.MAVLink_global_position_int_message(
            self.vehicles[who].boot_ms(self.now_s),
            *(round(at.lat_deg * 1e7), round(at.lon_deg * 1e7)),
            *(round((250.0 - down_m) * 1e3), round((-down_m - home_m) * 1e3)),
            *(round(vn * 100), round(ve * 100), round(vd * 100), 0),
        )

    def _deliver(self) -> None:
        while self._late and self._late[0][0] <= self.now_s:
            _, who, message = self._late.popleft()
            self._tell(who, message)

    def _tell(self, who: int, message: Any) -> None:
        sender = mavlink.MAVLink(None, srcSystem=who, srcComponent=1)
        self.session.receive(
            mavlink.MAVLink(None).decode(bytearray(message.pack(sender))), self.now_s
        )

    def _tick(self) -> None:
        for who, message in self.session.tick(self.now_s):
            if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
                place = GlobalPosition(message.lat_int / 1e7, message.lon_int / 1e7, 250.0)
                north_m, east_m, _ = ned_between(HERE, place)
                up_m = message.alt + self._home_m
                self.copters[RELAY].guided_position((north_m, east_m, -up_m))
            for answer in self.vehicles[who].answer(message, self.now_s):
                self._tell(who, answer)
