"""A leader and followers that have said where they are: the input of one step of a tick."""

from dataclasses import dataclass, field
from typing import Any

from echowing.flight.follower import FollowerPlan, FollowerState
from echowing.flight.guard import Guard, Limits
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.known import Known
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.sonar_file import shipped_sonar

from .yard import FOLLOWER, HERE, LEADER, Vehicle

HEIGHT_M = 10.0


@dataclass
class Told:
    """Clocks are known and links take no time, so that a report is of this moment.

    said: what the steps told of, as the arguments of the call.
    """

    vehicles: dict[int, Vehicle]
    limits: Limits | None = None
    settings: GuidanceSettings = field(default_factory=lambda: GuidanceSettings(learn_offset=False))
    altitude_m: float = HEIGHT_M
    now_s: float = 0.0
    said: list[tuple[Any, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        plans = [
            FollowerPlan(one, Slot(3.0), self.altitude_m, sonar=shipped_sonar())
            for one in self.vehicles
            if one != LEADER
        ]
        homes = None if self.limits is None else self.limits.homes(LEADER)
        self.known = Known(LEADER, plans, self.settings, homes)
        self.guard = None if self.limits is None else Guard(self.limits, self.known, self.tell)
        for system_id, vehicle in self.vehicles.items():
            clock = self.known.clock(system_id)
            assert clock is not None
            clock.answered(0.0, -vehicle.boot_s, 0.0)
            self.report(system_id)

    def tell(self, *said: Any) -> None:
        """Note what a step says."""
        self.said.append(said)

    def position(self, system_id: int) -> Any:
        """A vehicle's GLOBAL_POSITION_INT of now."""
        return self.vehicles[system_id].position(self.now_s)

    def report(self, system_id: int) -> None:
        """Let a vehicle report where it is."""
        message = self.position(system_id)
        self.known.homes.reported(system_id, message)
        if self.guard is not None:
            self.guard.receive(system_id, "GLOBAL_POSITION_INT", message, self.now_s)
        if system_id == LEADER:
            self.known.leader.receive(message, self.now_s)
        else:
            self.known.followers[system_id].reported(message, self.now_s)

    @property
    def follower(self) -> FollowerState:
        """The first follower."""
        return self.known.followers[FOLLOWER]


def at(north_m: float, east_m: float = 0.0, height_m: float = HEIGHT_M) -> GlobalPosition:
    """A place so far from `HERE`, where vehicles' homes are."""
    return displace(HERE, (north_m, east_m, -height_m))


def from_here_m(place: GlobalPosition) -> tuple[float, float]:
    """How far a place is from `HERE`, (north, east)."""
    north_m, east_m, _ = ned_between(HERE, place)
    return north_m, east_m
