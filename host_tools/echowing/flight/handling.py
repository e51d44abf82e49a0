"""How a follower answers, from its own parameters, and what a leader's reversal takes. Pure.

The envelope uses a vehicle's own acceleration and jerk. They give beforehand the distance that is
left when a leader turns round, and how near a slot may be.
"""

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.closing import Closing
from echowing.flight.envelope import LEAST_M, OTHERS_MPS2, Answer
from echowing.flight.vehicle_limits import ACCELERATION, BY_NAME, JERK, LEAN
from echowing.flight.wind import GRAVITY_MPS2

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
        """Take a parameter of its autopilot; one out of its span tells nothing."""
        limit = BY_NAME.get(name)
        read = None if limit is None else limit.read(name, value)
        if read is None:
            return
        if limit is ACCELERATION:
            self.decel_mps2 = read
        elif limit is JERK:
            self.jerk_mps3 = read
        elif limit is LEAN:
            self.lean_max_rad = math.radians(read)

    def asks(self, now_s: float) -> list[str]:
        """The parameters to request now."""
        period_s = ASK_PERIOD_S if self._asks < OFTEN else SELDOM_S
        if self.known or now_s - self._asked_at_s < period_s:
            return []
        self._asked_at_s = now_s
        self._asks += 1
        missing = ACCELERATION.names if self.decel_mps2 is None else {}
        first = LEAN.names if self._asks <= OFTEN else {}
        return [*missing, *(JERK.names if self.jerk_mps3 is None else {}), *first]


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


def least_slot_m(
    speed_mps: float,
    answer: Answer,
    least_m: float = LEAST_M,
    noticed_s: float = NOTICED_S,
    brakes_mps2: float = OTHERS_MPS2,
) -> float:
    """The nearest slot from which a reversal of the leader leaves `least_m`; inf: none does.

    speed_mps: the leader's; it reverses to the same speed the other way at `brakes_mps2`. After
    `noticed_s` the sonar, or a report, shows it to the follower, which then reverses by its own
    `answer`.
    """
    speed_mps, decel_mps2 = abs(speed_mps), answer.decel_mps2
    unaware_s = noticed_s + answer.dead_s
    if speed_mps == 0.0:
        return least_m
    if not (decel_mps2 > 0.0 and brakes_mps2 > 0.0 and math.isfinite(speed_mps + unaware_s)):
        return math.inf
    # Both fly back at `speed_mps` in the end: the later one was so much longer on its way out.
    later_s = unaware_s + speed_mps / decel_mps2 - speed_mps / brakes_mps2
    lost_m = 2.0 * speed_mps * later_s
    gains_mps2 = decel_mps2 - brakes_mps2
    if gains_mps2 > 0.0:
        # One that brakes harder is as fast as the leader sooner, if that is before the end.
        closing_mps = brakes_mps2 * unaware_s
        equal_s = unaware_s + closing_mps / gains_mps2
        if equal_s * brakes_mps2 <= 2.0 * speed_mps:
            lost_m = 0.5 * closing_mps * equal_s
    return least_m + lost_m
