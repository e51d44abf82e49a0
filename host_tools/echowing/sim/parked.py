"""Vehicles on the ground as they come from the factory, to be set up by `echowing setup`.

Nothing is set up on them: the parameters are the firmware's, and no applet is on their cards. The
followers' co-processors are wired to SERIAL2, which hears them only at the right baud rate.
"""

from collections.abc import Sequence
from pathlib import Path

from echowing.errors import EchowingError
from echowing.geo import Ned
from echowing.sim.aircraft import (
    AUTOPILOT_PORT,
    COPROCESSOR,
    LeaderPilot,
    SimFollower,
    SimVehicle,
)
from echowing.sim.flight import FormationWorld
from echowing.sim.hangar import FIRST_FOLLOWER_ID, LEADER_ID, Hangar, Listen
from echowing.sim.scenario import Scenario
from echowing.sim.vehicle.copter import Copter
from echowing.sim.vehicle.parameters import Parameters

COPROCESSOR_BAUD = (115.0, 115_200.0)  # SERIAL2_BAUD, either way of writing 115200
MAVLINK_PROTOCOLS = (1.0, 2.0)  # SERIAL2_PROTOCOL


class ParkedFollower(SimFollower):
    """A follower whose serial port has to be set up; it takes settings when it starts."""

    _booted_with: Parameters | None = None
    _port_is_right = False

    def run_coprocessor(self, t_us: int, dt_s: float) -> None:
        """As `SimFollower.run_coprocessor`; at another baud rate neither end understands."""
        if self.driver is not None or self._wired():
            super().run_coprocessor(t_us, dt_s)
            return
        self.autopilot.transmit(COPROCESSOR)
        self.coprocessor.run_until(t_us)
        self.coprocessor.take(AUTOPILOT_PORT)

    def _wired(self) -> bool:
        parameters = self.autopilot.parameters
        if parameters is not self._booted_with:  # the autopilot makes new ones when it starts
            self._booted_with = parameters
            self._port_is_right = (
                parameters.value("SERIAL2_BAUD") in COPROCESSOR_BAUD
                and parameters.value("SERIAL2_PROTOCOL") in MAVLINK_PROTOCOLS
            )
        return self._port_is_right


class ParkedHangar(Hangar):
    """Vehicles with motors off. Only what the scenario names itself is set on the followers."""

    def leader(self) -> SimVehicle:
        """The leader at the origin."""
        body = Copter((0.0, 0.0, 0.0), tuning=self._tuning())
        drift, wind = self._drift("leader", body, parked=True), self._wind("leader", body)
        return SimVehicle(body, self._autopilot(body, LEADER_ID, {}), drift, wind)

    def follower(
        self, index: int, start_ned_m: Ned, yaw_rad: float, speed_mps: float, listen: Listen
    ) -> SimFollower:
        """Follower number `index` (from 0) below where it would fly."""
        body = Copter((start_ned_m[0], start_ned_m[1], 0.0), yaw_rad, tuning=self._tuning())
        saved = self.scenario.follower.parameters
        follower = ParkedFollower(
            body,
            self._autopilot(body, FIRST_FOLLOWER_ID + index, saved),
            self._drift(f"follower {index}", body, parked=True),
            listen=listen,
            make_coprocessor=self._make_coprocessor,
            ear=self.ear(index),
            wire=self.cutters(f"wire {index}", self.scenario.wire),
            wind=self._wind(f"follower {index}", body),
        )
        self.fit(follower)
        return follower


class ParkedWorld(FormationWorld):
    """A scenario's vehicles with nobody at their controls."""

    def __init__(self, scenario: Scenario, hangar: ParkedHangar) -> None:
        super().__init__(scenario, hangar)
        self.pilot = _Absent(self.leader, scenario.leader)


class _Absent(LeaderPilot):
    """A leader's pilot who does nothing."""

    def step(self, t_s: float, follower: Ned) -> None:
        """Nothing."""


def insert_cards(followers: Sequence[SimFollower], folder: Path) -> None:
    """Give each follower the SD card `folder`/SYSTEM_ID, made if it is not there.

    Raises EchowingError where that cannot be.
    """
    for follower in followers:
        card = folder / str(follower.autopilot.system_id)
        try:
            (card / "APM").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise EchowingError(f"--card {card}: cannot be made: {error.strerror}") from error
        follower.autopilot.insert_card(card)
