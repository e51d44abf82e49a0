"""Where the leader truly is for its follower, from two vehicles in ArduPilot's SITL.

A sonar hears what is there, not what the vehicles' receivers believe: SIM_STATE is SITL's word for
that. Nothing here blocks, and a vehicle that is not heard yet, or no more, is not heard by the
sonar either.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.geo import GlobalPosition, Ned, ned_between
from echowing.mavlink.connection import DEFAULT_BAUD
from echowing.mavlink.links import Link
from echowing.mavlink.messages import HEARTBEAT_PERIOD_S, message_interval, tool_heartbeat
from echowing.mavlink.seats import OpenLink, Say, VehicleFinder, known_id, parse_seat
from echowing.sim.world.sonar import body_to_ned

RATE_HZ = 50.0
# Sockets are looked at this often; a state is carried on with its velocity in between.
LOOK_S = 0.005
STALE_S = 0.5
AXES: tuple[Ned, Ned, Ned] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class TrueState:
    """A SIM_STATE, and when it came. Velocity NED, m/s."""

    time_s: float
    place: GlobalPosition
    velocity_mps: Ned
    attitude_rad: tuple[float, float, float]

    def moved_on_m(self, now_s: float) -> Ned:
        """How far it has flown since, NED."""
        age_s = now_s - self.time_s
        north, east, down = self.velocity_mps
        return north * age_s, east * age_s, down * age_s


def true_state(message: Any, now_s: float) -> TrueState:
    """A SIM_STATE read. Raises EchowingError for one without its whole numbers of degrees."""
    if message.lat_int == 0 and message.lon_int == 0:
        raise EchowingError(
            "this SITL reports its place to half a metre only (SIM_STATE without lat_int); use "
            "ArduCopter 4.5 or later"
        )
    return TrueState(
        now_s,
        GlobalPosition(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt),
        (message.vn, message.ve, message.vd),
        (message.roll, message.pitch, message.yaw),
    )


def in_body_frame(leader: TrueState, follower: TrueState, now_s: float) -> Ned:
    """Where the leader is from the follower: forward, right and down, metres, at `now_s`."""
    vector = ned_between(follower.place, leader.place)
    ahead, behind = leader.moved_on_m(now_s), follower.moved_on_m(now_s)
    ned = [a + b - c for a, b, c in zip(vector, ahead, behind, strict=True)]
    forward, right, down = (
        sum(a * b for a, b in zip(ned, body_to_ned(axis, *follower.attitude_rad), strict=True))
        for axis in AXES
    )
    return forward, right, down


class SitlScene:
    """Listens to two vehicles; `leader_body_m` is where the sonar has the leader."""

    def __init__(
        self,
        leader: str,
        follower: str,
        *,
        clock: Callable[[], float] = time.monotonic,
        say: Say = print,
        make_link: Callable[[Any], Link] = Link,
    ) -> None:
        self._seats = [
            parse_seat(role, text, DEFAULT_BAUD)
            for role, text in (("leader", leader), ("follower", follower))
        ]
        self._finder = VehicleFinder(self._seats)
        self._links = {seat.address.text: OpenLink(make_link(seat.address)) for seat in self._seats}
        self._clock, self._say = clock, say
        self._states: dict[int, TrueState] = {}
        self._look_s = self._ask_s = 0.0
        self._told = False
        for one in self._links.values():
            one.link.open()

    def leader_body_m(self) -> Ned | None:
        """Forward, right and down, metres; None: not known, or no more."""
        now_s = self._clock()
        if now_s >= self._look_s:
            self._look_s = now_s + LOOK_S
            self._listen(now_s)
        if now_s >= self._ask_s:
            self._ask_s = now_s + HEARTBEAT_PERIOD_S
            self._ask(now_s)
        states = [self._states.get(seat.system_id or 0) for seat in self._seats]
        leader, follower = states
        if leader is None or follower is None:
            return None
        if now_s - min(leader.time_s, follower.time_s) > STALE_S:
            return None
        self._tell()
        return in_body_frame(leader, follower, now_s)

    def _listen(self, now_s: float) -> None:
        for text, link in self._links.items():
            for message in link.receive(now_s, self._say):
                self._finder.heard(text, message, now_s)
                if message.get_type() == "SIM_STATE":
                    self._states[message.get_srcSystem()] = true_state(message, now_s)
        self._finder.decide(now_s)

    def _ask(self, now_s: float) -> None:
        """Be heard, and ask for the truth, which a vehicle that restarts forgets to send."""
        for link in self._links.values():
            link.send(tool_heartbeat(), now_s)
        if not self._finder.complete:
            return
        period_us = round(1e6 / RATE_HZ)
        for seat in self._seats:
            ask = message_interval(known_id(seat), mavlink.MAVLINK_MSG_ID_SIM_STATE, period_us)
            self._links[seat.address.text].send(ask, now_s)

    def _tell(self) -> None:
        if not self._told:
            self._told = True
            leader, follower = map(known_id, self._seats)
            self._say(f"the sonar detects system {leader} from system {follower}")

    def close(self) -> None:
        """Hang up."""
        for one in self._links.values():
            one.link.close()
