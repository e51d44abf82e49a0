"""The followers' pilots of a simulated flight, as far as they have to act. Deterministic."""

from collections.abc import Callable

from echowing.flight.follower import FollowerState
from echowing.sim.vehicle.autopilot import Autopilot
from echowing.sim.vehicle.modes import GUIDED, LOITER

# He sees on his display why it stands, looks that all is clear, and takes his mode switch.
LOOKS_S = 5.0
# Long enough for two heartbeats, so that the ground sees that he has left Guided.
AWAY_S = 2.5


class Pilot:
    """Engages one follower again, by leaving Guided and coming back, where it waits for that.

    While he has taken it over himself he does nothing else.
    """

    def __init__(self, autopilot: Autopilot, state: Callable[[], FollowerState]) -> None:
        self._autopilot = autopilot
        self._state = state
        self._since_s: float | None = None
        self._away_since_s: float | None = None
        self._flies_himself = self._engages = False

    def takes_over(self, mode: str) -> None:
        """Take the vehicle in a mode of his."""
        self._flies_himself = True
        self._away_since_s = self._since_s = None
        self._autopilot.set_mode(mode)

    def comes_back(self) -> None:
        """Put it back in Guided."""
        self._flies_himself = False
        self._autopilot.set_mode("GUIDED")

    def engages_again(self) -> None:
        """Leave Guided and come back, as soon as he has looked."""
        self._engages = True

    def step(self, t_s: float) -> None:
        """One moment of his attention."""
        if self._flies_himself or self._autopilot.modes.mode not in (GUIDED, LOITER):
            return  # he flies it, or a fail-safe does
        if self._away_since_s is not None:
            if t_s - self._away_since_s >= AWAY_S:
                self._autopilot.set_mode("GUIDED")
                self._away_since_s = self._since_s = None
        elif self._state().turn.latched is None and not self._engages:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = t_s
        elif t_s - self._since_s >= LOOKS_S:
            self._autopilot.set_mode("LOITER")
            self._away_since_s = t_s
            self._engages = False
