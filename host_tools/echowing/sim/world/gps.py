"""What a vehicle errs by: position and height by its receiver, and height by its barometer."""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from echowing.geo import Ned

# Ten seconds' mean of a receiver's speed at rest is right within 0.05 m/s, and it is off for a few
# seconds at a time (T. Chalko, Estimating accuracy of GPS Doppler speed measurement, 2009).
VELOCITY_TAU_S = 2.5


@dataclass(frozen=True, slots=True)
class Errors:
    """How far off a vehicle is, by standard deviations, and for how long.

    sigma_m, tau_s: each horizontal axis of the receiver, which wanders slowly. height_sigma_m,
    height_tau_s: the height that the autopilot reports and flies by, which is its barometer's.
    receiver_height_sigma_m: the receiver's own. velocity_sigma_mps: each horizontal axis of the
    velocity that the receiver tells. follows_s, height_follows_s: how much later the autopilot's
    filter follows (`Filter`), so that its estimate glides where the receiver's position, or the
    barometer's height, would jitter, as EKF3 does on ArduCopter SITL (tests/sitl/follows.py).
    step_m, step_every_s: each axis of a step as another satellite counts, which fades with `tau_s`,
    and how often one comes (infinite: never). multipath_m, multipath_s: each axis of what echoes of
    the satellites' signals add.
    """

    sigma_m: float = 0.0
    tau_s: float = 60.0
    height_sigma_m: float = 0.0
    height_tau_s: float = 60.0
    receiver_height_sigma_m: float = 0.0
    velocity_sigma_mps: float = 0.0
    follows_s: float = 1.5
    height_follows_s: float = 2.8
    step_m: float = 0.0
    step_every_s: float = math.inf
    multipath_m: float = 0.0
    multipath_s: float = 10.0


class _Wander:
    """A first-order Gauss-Markov error (metres); begins in its steady state, or at rest."""

    def __init__(
        self, sigma_m: float, tau_s: float, chance: random.Random, *, at_rest: bool = False
    ) -> None:
        self._sigma_m = sigma_m
        self._tau_s = tau_s
        self._chance = chance
        first_m = chance.gauss(0.0, sigma_m)
        self.error_m = 0.0 if at_rest else first_m
        self._dt_s = -1.0
        self._keep = self._kick_m = 0.0

    def step(self, dt_s: float) -> float:
        """The error after `dt_s` more seconds."""
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._keep = math.exp(-dt_s / self._tau_s)
            self._kick_m = self._sigma_m * math.sqrt(1.0 - self._keep * self._keep)
        self.error_m = self._keep * self.error_m + self._chance.gauss(0.0, self._kick_m)
        return self.error_m


class _Steps:
    """An error that jumps now and then, and fades (metres)."""

    def __init__(self, step_m: float, every_s: float, fades_s: float, chance: random.Random):
        self._step_m, self._every_s, self._fades_s = step_m, every_s, fades_s
        self._chance = chance
        self.error_m = 0.0
        self._left_s = chance.expovariate(1.0) * every_s

    def step(self, dt_s: float) -> float:
        """The error after `dt_s` more seconds."""
        self.error_m *= math.exp(-dt_s / self._fades_s)
        self._left_s -= dt_s
        if self._left_s <= 0.0:
            self.error_m += self._chance.gauss(0.0, self._step_m)
            self._left_s += self._chance.expovariate(1.0) * self._every_s
        return self.error_m


class _Height:
    """What the autopilot's filter makes of its barometer (metres)."""

    def __init__(self, follows_s: float, error: _Wander) -> None:
        self._follows_s, self._error = follows_s, error
        self._error_m = error.error_m
        self._dt_s, self._blend = -1.0, 0.0

    def step(self, dt_s: float) -> float:
        """The estimate's error after `dt_s` more seconds."""
        if dt_s != self._dt_s:
            self._dt_s, self._blend = dt_s, 1.0 - math.exp(-dt_s / self._follows_s)
        self._error_m += self._blend * (self._error.step(dt_s) - self._error_m)
        return self._error_m


class Filter:
    """What the autopilot's filter makes of its receiver on one axis: metres, metres per second.

    It takes the receiver's velocity for surer than its place. So where the place is drawn away, a
    part of that shows in the velocity; and a part is taken for an accelerometer that is off, for
    which the velocity soon turns round. The gains are fitted to EKF3 with its default noises: steps
    of 0.5 to 3 m of the receiver of a vehicle that hovers (ArduCopter SITL 4.6 and 4.8, the same
    digits) and the slow drift of four in a formation. They leave 0.05 m and 0.02 m/s. Slower or
    quicker as it follows: 0.63 of a step after `follows_s`. How the error changes within 3 s, and
    how far the place moves otherwise than its velocity says, correlate by 0.78 to 0.88 there
    (tests/sitl/follows.py), here by 0.86.
    """

    def __init__(self, follows_s: float, error_m: float) -> None:
        self.error_m, self.error_mps, self._leans_mps2 = error_m, 0.0, 0.0
        self._place_per_s, self._velocity_per_s = 0.66 / follows_s, 0.42 / follows_s
        self._turns_per_s2 = 0.60 / follows_s**2
        self._leans_per_s3, self._rights_per_s = 0.14 / follows_s**3, 0.30 / follows_s

    def step(self, told_m: float, told_mps: float, dt_s: float) -> None:
        """Follow a receiver that errs by so much for `dt_s`."""
        behind_m, slow_mps = told_m - self.error_m, told_mps - self.error_mps
        self.error_m -= behind_m * math.expm1(-self._place_per_s * dt_s)
        self.error_m += self.error_mps * dt_s
        self.error_mps += (self._turns_per_s2 * behind_m - self._leans_mps2) * dt_s
        self.error_mps -= slow_mps * math.expm1(-self._velocity_per_s * dt_s)
        self._leans_mps2 += self._leans_per_s3 * behind_m * dt_s
        self._leans_mps2 += self._leans_mps2 * math.expm1(-self._rights_per_s * dt_s)


class _Axis:
    """One horizontal axis: a receiver's errors, and the filter that follows them."""

    def __init__(self, follows_s: float, velocity: _Wander, *errors: _Wander | _Steps) -> None:
        self._velocity, self._errors = velocity, errors
        self.filter = Filter(follows_s, sum(one.error_m for one in errors))

    def step(self, dt_s: float) -> float:
        """The error of the estimated place after `dt_s` more seconds."""
        told_m = sum(one.step(dt_s) for one in self._errors)
        self.filter.step(told_m, self._velocity.step(dt_s), dt_s)
        return self.filter.error_m


class Drift:
    """How a vehicle's estimate of its own place wanders. Starts in the steady state.

    chance(name): a stream of chance for each error, so that none changes another; without a name
    that of the slow drift. parked: its
    autopilot starts now, and takes its barometer for right. by_receiver: it flies by the
    receiver's height.
    """

    def __init__(
        self,
        errors: Errors,
        chance: Callable[[str], random.Random],
        *,
        parked: bool = False,
        by_receiver: bool = False,
    ) -> None:
        drifts, follows_s = chance(""), errors.follows_s
        self._north, self._east = (
            _Axis(
                follows_s,
                _Wander(errors.velocity_sigma_mps, VELOCITY_TAU_S, chance(f"{axis} velocity")),
                _Wander(errors.sigma_m, errors.tau_s, drifts),
                *_beside(errors, chance, axis),
            )
            for axis in ("north", "east")
        )
        barometer = _Wander(
            errors.height_sigma_m, errors.height_tau_s, chance("height"), at_rest=parked
        )
        self._receiver_height = _Wander(
            errors.receiver_height_sigma_m, errors.tau_s, chance("receiver height")
        )
        self._height = _Height(
            errors.height_follows_s, self._receiver_height if by_receiver else barometer
        )
        self._by_receiver = by_receiver
        self.jump_ned_m: Ned = (0.0, 0.0, 0.0)
        self._reset_ned_m: Ned = (0.0, 0.0, 0.0)

    def jump_to(self, jump_ned_m: Ned) -> None:
        """The filter gives up its estimate for one that is off by so much."""
        before, reset = self.jump_ned_m, self._reset_ned_m
        north, east, down = (r + b - a for a, b, r in zip(before, jump_ned_m, reset, strict=True))
        self.jump_ned_m, self._reset_ned_m = jump_ned_m, (north, east, down)

    def taken_reset(self) -> Ned:
        """By how much the filter has reset its estimate since it was asked last."""
        reset_ned_m, self._reset_ned_m = self._reset_ned_m, (0.0, 0.0, 0.0)
        return reset_ned_m

    def step(self, dt_s: float) -> Ned:
        """Offset (estimated minus true, NED metres) after `dt_s` more seconds.

        `jump_ned_m`, a fault, is added at once.
        """
        north, east = self._north.step(dt_s), self._east.step(dt_s)
        down, jump = self._height.step(dt_s), self.jump_ned_m
        if not self._by_receiver:
            self._receiver_height.step(dt_s)
        return north + jump[0], east + jump[1], down + jump[2]

    @property
    def velocity_mps(self) -> tuple[float, float]:
        """How far off the estimated velocity is, (north, east)."""
        return self._north.filter.error_mps, self._east.filter.error_mps

    @property
    def receiver_down_m(self) -> float:
        """How far off the receiver's own height is, down."""
        return self._receiver_height.error_m + self.jump_ned_m[2]


def _beside(
    errors: Errors, chance: Callable[[str], random.Random], axis: str
) -> list[_Wander | _Steps]:
    """What a receiver errs by on one axis beside its slow drift."""
    found: list[_Wander | _Steps] = []
    if math.isfinite(errors.step_every_s):
        steps = chance(f"{axis} steps")
        found.append(_Steps(errors.step_m, errors.step_every_s, errors.tau_s, steps))
    if errors.multipath_m > 0.0:
        found.append(_Wander(errors.multipath_m, errors.multipath_s, chance(f"{axis} multipath")))
    return found
