"""How a follower answers, from its own parameters, and what a leader's reversal takes. Pure.

The envelope uses a vehicle's own acceleration, jerk and lean, and how quickly it leans. They give
beforehand the distance that is left when a leader turns round, and how near a slot may be.
"""

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.clocks import ASK_PERIOD_S
from echowing.flight.closing import Closing
from echowing.flight.envelope import LEAST_M, OTHERS_MPS2, Answer
from echowing.geo import GRAVITY_MPS2
from echowing.mavlink.vehicle_limits import (
    ACCELERATION,
    BY_NAME,
    GUIDED_LEAN,
    INPUT_TIME,
    JERK,
    LEAN,
    LIMITS,
    PITCH_ACCELERATION,
    PITCH_RATE,
    ROLL_ACCELERATION,
    ROLL_RATE,
    VehicleLimit,
)

# Once a second at first, then seldom: a noisy radio loses both request and answer.
SELDOM_S = 5.0
OFTEN = 5
# From an order to the first lean: half a control period of the points (8 Hz) and the motors, and
# the lean's own shaping. Up to ArduCopter 4.7 that is one lag of ATC_INPUT_TC, in 4.8 two
# (attitude_command_model, AC_AttitudeControl.cpp), but its controller asks for more meanwhile.
# With the default 0.15 s either is the 0.35 s that SITL's steps show.
ONE_LAG_S, TWO_LAGS_S = 0.2, 0.05
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


class Handling:
    """How one follower moves, by what it has reported; what it has not counts as the worst.

    answer_in_calm: how it answers without wind; closing: how Guided closes the distance to its
    point, a forecast, so with ArduCopter's defaults for what is not known; lean_max_rad: its
    largest lean; wind_leaves_mps2: the hardest braking that the wind leaves it.
    """

    def __init__(self) -> None:
        self.wind_leaves_mps2 = math.inf
        self._limits: dict[VehicleLimit, float] = {}
        self._asked_at_s = -math.inf
        self._asks = 0
        self._work_out()

    @property
    def answer(self) -> Answer:
        """How it answers in this wind."""
        calm = self.answer_in_calm
        if self.wind_leaves_mps2 >= calm.decel_mps2:
            return calm
        # To a tenth: what depends on it is worked out once for each value.
        return Answer(calm.dead_s, round(self.wind_leaves_mps2, 1))

    @property
    def known(self) -> bool:
        """Whether acceleration and jerk are known."""
        return ACCELERATION in self._limits and JERK in self._limits

    @property
    def missing(self) -> list[str]:
        """The parameters that are not known, each by its newest name."""
        return [next(iter(one.names)) for one in LIMITS if one not in self._limits]

    def receive(self, name: str, value: float) -> None:
        """Take a parameter of its autopilot; one out of its span tells nothing."""
        limit = BY_NAME.get(name)
        read = None if limit is None else limit.read(name, value)
        if limit is not None and read is not None:
            self._limits[limit] = read
            self._work_out()

    def asks(self, now_s: float) -> list[str]:
        """The parameters to request now."""
        period_s = ASK_PERIOD_S if self._asks < OFTEN else SELDOM_S
        if now_s - self._asked_at_s < period_s or len(self._limits) == len(LIMITS):
            return []
        self._asked_at_s = now_s
        self._asks += 1
        return [name for one in LIMITS if one not in self._limits for name in one.names]

    def _work_out(self) -> None:
        worst = {one: self._limits.get(one, one.worst) for one in LIMITS}
        usual = {one: self._limits.get(one, one.usual) for one in LIMITS}
        self.lean_max_rad = math.radians(min(worst[LEAN], worst[GUIDED_LEAN]))
        self.answer_in_calm = answer_of(
            min(worst[ACCELERATION], GRAVITY_MPS2 * math.tan(self.lean_max_rad)),
            _flown_jerk_mps3(worst),
            reaction_s(worst[INPUT_TIME]),
        )
        self.closing = Closing(usual[ACCELERATION], _flown_jerk_mps3(usual))


def _flown_jerk_mps3(limits: Mapping[VehicleLimit, float]) -> float:
    return flown_jerk_mps3(
        limits[ACCELERATION],
        limits[JERK],
        min(limits[ROLL_RATE], limits[PITCH_RATE]),
        min(limits[ROLL_ACCELERATION], limits[PITCH_ACCELERATION]),
    )


def answer_of(decel_mps2: float, jerk_mps3: float, reaction_s: float) -> Answer:
    """Dead time and deceleration of a vehicle with these limits.

    A deceleration that builds up at a jerk counts as a full one that begins half that time later.
    """
    return Answer(reaction_s + decel_mps2 / (2.0 * jerk_mps3), decel_mps2)


def reaction_s(input_time_s: float) -> float:
    """From an order to the first lean, by ATC_INPUT_TC."""
    return max(ONE_LAG_S + input_time_s, TWO_LAGS_S + 2.0 * input_time_s)


def flown_jerk_mps3(
    accel_mps2: float, jerk_mps3: float, rate_dps: float, acceleration_dps2: float
) -> float:
    """The jerk that is flown, whatever its parameter allows (AC_PosControl.cpp).

    As much as the lean's rate makes, and half the root of the acceleration times the snap of the
    lean's acceleration: at 1100 deg/s2 15.3 m/s3, at 300 8.0 m/s3, with 5 m/s2.
    """
    by_rate_mps3 = math.radians(rate_dps) * GRAVITY_MPS2
    snap_mps4 = math.radians(acceleration_dps2) * GRAVITY_MPS2
    return min(jerk_mps3, by_rate_mps3, 0.5 * math.sqrt(accel_mps2 * snap_mps4))


def leader_brakes_mps2(mode: int | None) -> float:
    """How hard a leader may brake and turn round, by its mode; None: not known."""
    return OTHERS_MPS2 if mode in MISSION_MODES else STEERED_MPS2


def least_slot_m(
    speed_mps: float,
    answer: Answer,
    noticed_s: float,
    least_m: float = LEAST_M,
    brakes_mps2: float = OTHERS_MPS2,
    *,
    stops: bool = False,
) -> float:
    """The nearest slot from which a reversal of the leader leaves `least_m`; inf: none does.

    speed_mps: the leader's; it reverses to the same speed the other way at `brakes_mps2`, or
    `stops`. After `noticed_s` the sonar (`SonarBelief.noticed_s`), or a report, shows it to the
    follower, which then does the same by its own `answer`.
    """
    change_mps, decel_mps2 = abs(speed_mps) * (1.0 if stops else 2.0), answer.decel_mps2
    unaware_s = noticed_s + answer.dead_s
    if change_mps == 0.0:
        return least_m
    if not (decel_mps2 > 0.0 and brakes_mps2 > 0.0 and math.isfinite(change_mps + unaware_s)):
        return math.inf
    # Both are as fast in the end: the later one flew so much longer at the other speed.
    lost_m = change_mps * unaware_s + 0.5 * change_mps**2 * (1.0 / decel_mps2 - 1.0 / brakes_mps2)
    gains_mps2 = decel_mps2 - brakes_mps2
    if gains_mps2 > 0.0:
        # One that brakes harder is as fast as the leader sooner, if that is before the end.
        closing_mps = brakes_mps2 * unaware_s
        equal_s = unaware_s + closing_mps / gains_mps2
        if equal_s * brakes_mps2 <= change_mps:
            lost_m = 0.5 * closing_mps * equal_s
    return least_m + lost_m
