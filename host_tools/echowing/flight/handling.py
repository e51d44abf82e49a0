"""How a follower answers, from its own parameters, and what a leader's reversal takes. Pure.

The envelope uses a vehicle's own acceleration and jerk. They give beforehand the distance that is
left when a leader turns round, and how near a slot may be.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.closing import Closing
from echowing.flight.envelope import LEAST_M, OTHERS_MPS2, Answer
from echowing.flight.wind import GRAVITY_MPS2

# Names in ArduCopter 4.7 and later, and before, with the factor to SI units.
ACCELERATIONS = {"WP_ACC": 1.0, "WPNAV_ACCEL": 0.01}
JERKS = {"PSC_JERK_NE": 1.0, "PSC_JERK_XY": 1.0}
LEANS = {"ATC_ANGLE_MAX": math.radians(1.0), "ANGLE_MAX": math.radians(0.01)}
# Once a second at first, then seldom: a noisy radio loses both request and answer.
ASK_PERIOD_S, SELDOM_S = 1.0, 5.0
OFTEN = 5
# From an order to the first lean: half a control period of the points (8 Hz), and 0.3 s until the
# lean is reached (ATC_INPUT_TC 0.15 and the motors).
REACTION_S = 0.35
# However high PSC_JERK_NE is, the jerk stays below half the root of the acceleration times the snap
# of the lean's angular acceleration (ATC_ACC_R_MAX 1100 deg/s2; AC_PosControl.cpp).
SNAP_MPS4 = math.radians(1100.0) * GRAVITY_MPS2
# A leader on a mission brakes with its WP_ACC (`OTHERS_MPS2`, the default). Steered by a pilot or a
# ground station it can do more: 3.3 to 3.5 m/s2 in 100 reversals in Guided, ArduCopter 4.8.
MISSION_MODES = {
    mavlink.COPTER_MODE_AUTO,
    mavlink.COPTER_MODE_RTL,
    mavlink.COPTER_MODE_LAND,
    mavlink.COPTER_MODE_SMART_RTL,
    mavlink.COPTER_MODE_AUTO_RTL,
}
STEERED_MPS2 = 3.4
# From a leader's first braking to the follower's order: a period of the sonar (0.1 s), a second
# reading that confirms it, and the time until the range differs (0.1 s at 2.5 m/s2 is 0.01 m, a
# sonar's step; 0.15 s are 0.03 m).
NOTICED_S = 0.3
STEP_S = 0.005


@dataclass(slots=True)
class Handling:
    """What one follower has reported of its acceleration and jerk; None: nothing yet.

    lean_max_rad: its largest lean, ArduCopter's default until it has reported it; wind_leaves_mps2:
    the hardest braking that the wind leaves it.
    """

    decel_mps2: float | None = None
    jerk_mps3: float | None = None
    lean_max_rad: float = math.radians(30.0)
    wind_leaves_mps2: float = math.inf
    _asked_at_s: float = -math.inf
    _asks: int = 0

    @property
    def answer(self) -> Answer:
        """How it answers in this wind; ArduCopter's defaults where it has not reported."""
        calm = self.answer_in_calm
        if self.wind_leaves_mps2 >= calm.decel_mps2:
            return calm
        # To a tenth: what depends on it is worked out once for each value.
        return Answer(calm.dead_s, round(self.wind_leaves_mps2, 1))

    @property
    def answer_in_calm(self) -> Answer:
        """How it answers without wind."""
        return answer_of(self.decel_mps2, self.jerk_mps3)

    @property
    def closing(self) -> Closing:
        """How Guided closes the distance to its point; ArduCopter's defaults likewise."""
        if self.decel_mps2 is None or self.jerk_mps3 is None:
            return Closing()
        return Closing(self.decel_mps2, _flown_jerk_mps3(self.decel_mps2, self.jerk_mps3))

    @property
    def known(self) -> bool:
        """Whether both are known."""
        return self.decel_mps2 is not None and self.jerk_mps3 is not None

    def receive(self, name: str, value: float) -> None:
        """Take a parameter of its autopilot."""
        if name in ACCELERATIONS and value > 0.0:
            self.decel_mps2 = value * ACCELERATIONS[name]
        elif name in JERKS and value > 0.0:
            self.jerk_mps3 = value * JERKS[name]
        elif name in LEANS and value > 0.0:
            self.lean_max_rad = value * LEANS[name]

    def asks(self, now_s: float) -> list[str]:
        """The parameters to request now."""
        period_s = ASK_PERIOD_S if self._asks < OFTEN else SELDOM_S
        if self.known or now_s - self._asked_at_s < period_s:
            return []
        self._asked_at_s = now_s
        self._asks += 1
        missing = ACCELERATIONS if self.decel_mps2 is None else {}
        first = LEANS if self._asks <= OFTEN else {}
        return [*missing, *(JERKS if self.jerk_mps3 is None else {}), *first]


def answer_of(decel_mps2: float | None, jerk_mps3: float | None) -> Answer:
    """Dead time and deceleration of a vehicle with these limits; None: ArduCopter's default.

    A deceleration that builds up at a jerk counts as a full one that begins half that time later.
    """
    if decel_mps2 is None or jerk_mps3 is None:
        return Answer()
    jerk_mps3 = _flown_jerk_mps3(decel_mps2, jerk_mps3)
    return Answer(REACTION_S + decel_mps2 / (2.0 * jerk_mps3), decel_mps2)


def _flown_jerk_mps3(accel_mps2: float, jerk_mps3: float) -> float:
    """The jerk that is flown, whatever the parameter allows."""
    return min(jerk_mps3, 0.5 * math.sqrt(accel_mps2 * SNAP_MPS4))


def leader_brakes_mps2(mode: int | None) -> float:
    """How hard a leader may brake and turn round, by its mode; None: not known."""
    return OTHERS_MPS2 if mode in MISSION_MODES else STEERED_MPS2


@lru_cache(maxsize=256)
def least_slot_m(
    speed_mps: float,
    answer: Answer,
    least_m: float = LEAST_M,
    noticed_s: float = NOTICED_S,
    brakes_mps2: float = OTHERS_MPS2,
) -> float:
    """The nearest slot from which a reversal of the leader leaves `least_m`.

    speed_mps: the leader's; it reverses to the same speed the other way at `brakes_mps2`. After
    `noticed_s` the sonar, or a report, shows it to the follower, which then reverses by its own
    `answer`.
    """
    notices_s = noticed_s + answer.dead_s
    leader_mps = follower_mps = abs(speed_mps)
    lost_m = most_lost_m = t_s = 0.0
    while leader_mps > -abs(speed_mps) or follower_mps > leader_mps:
        t_s += STEP_S
        leader_mps = max(-abs(speed_mps), leader_mps - brakes_mps2 * STEP_S)
        if t_s > notices_s:
            follower_mps = max(-abs(speed_mps), follower_mps - answer.decel_mps2 * STEP_S)
        lost_m += (follower_mps - leader_mps) * STEP_S
        most_lost_m = max(most_lost_m, lost_m)
    return least_m + most_lost_m
