"""What two vehicles' own positions disagree by, learnt from the sonar, and how sure that is. Pure.

Leader and follower each report a place a metre or so from the true one, and the errors wander over
a minute: the receivers' north and east, the barometers' up. Only their difference matters to a
formation, and the sonar shows it. A reading says that the leader is on an arc, at that range and
somewhere in the beam; silence says that it is not in the beam, or that the sonar is deaf. How far
receivers wander, how wide the beam is for this leader and how often it is heard, nobody knows
beforehand.

So this is no Kalman filter with given figures but a cloud of guesses (a particle filter; Gordon,
Salmond and Smith 1993): each is one difference (north, east, up) with its own figures for the
sonar. Guesses that foretell what the sonar says gain weight, and are repeated with small changes
(Liu and West 2001); the others die out. They are repeated as often as the root of their weight, and
keep the rest of it (Liu, Chen and Logvinenko 2001): so what is unlikely keeps many guesses, and a
leader that is not where it seemed is found again. What a deaf sonar leaves open stays open: some
guesses hold the sonar for deaf, and lose all weight with the first reading that fits. How receivers
wander is learnt beside it (`receivers`): guesses that are repeated forget it too soon.

A reading is used about a second late, once both vehicles' next reports are there. The guesses are
of that moment; `foretell` carries a copy of them on to when an order arrives.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from echowing.flight.axis import Axis
from echowing.flight.belief import SonarBelief
from echowing.flight.clocks import LOST_S
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.guidance import Horizontal
from echowing.flight.receivers import (
    FOLLOWS_S,
    FORGETS_S,
    REST_FORGETS_S,
    Receivers,
    passing,
)

Array = NDArray[np.float64]
# From follower to leader, by their own positions: (north, east, up).
Between = tuple[float, float, float]

# By their weights they count as some 2000, whose mean is off by a fortieth of their spread. Of what
# is one in 160 there are a hundred.
GUESSES = 4000
# One error in 160 is larger than what is allowed for: 2.5 standard deviations.
RISK = 1.0 / 160.0
# Both vehicles are known at the reading's moment to a decimetre.
PLACED_SIGMA_M = 0.15
# Readings nearer in time share their errors, and must not count twice. Guesses move by centimetres
# in this time.
UPDATE_PERIOD_S = 0.25
# Of a leader that is lost (`LOST_S`) this share of the ranges that nothing had foretold is its own:
# the receivers disagree by more than anybody thought. Three that agree outweigh all else. So are
# those of one that has just been found, which may be another one: until the sonar has looked
# elsewhere three times (`look.GLANCE_S`).
STEPPED, SURE_AFTER_S = 0.005, 5.0
# A sonar hears its leader somewhat more seldom than its file says at the least, or in nearly all
# readings.
HEARS, MOST_HEARD = (0.6, 1.9), 0.98
# This share of its readings is wrong: single wild ones near propellers, or a stranger's sonar. It
# is learnt, so that a range needs no second one to count. The same for each sonar file: one that
# was measured in a clean place says nothing of strangers, and none that says more than 0.1 carries
# a slot.
WRONG = (0.003, 0.3)
# Two vehicles nearer than this have no direction.
CLOSE_M = 0.1
# How a guess changes when it is repeated (Liu and West's discount of 0.98, for which 0.2 is the
# share of the spread), and by how far it moves.
KEPT_OF_SPREAD, NEW_OF_SPREAD, MOVES_M = 0.98, 0.2, 0.03
# A sonar falls deaf, and hears again, once in so long; how many of its readings are wrong changes
# as often as it falls deaf.
DEAFENS_S, RECOVERS_S = 600.0, 60.0
# A sonar that works has mostly found its leader by then: at the latest in ninety flights of
# `echowing bench --only accuracy --seeds 10`. One that has not may be deaf. As long as its silence
# ruled out what is near, three of eight followers with a deaf sonar came nearer than a metre.
SILENT_S = 30.0


class Off(NamedTuple):
    """What two vehicles' positions disagree by, metres, and how sure that is.

    level_sigma_m: standard deviation to the north and to the east; up_sigma_m: of their heights.
    """

    north_m: float
    east_m: float
    up_m: float
    level_sigma_m: float
    up_sigma_m: float


@dataclass(frozen=True, slots=True)
class Wandering:
    """What is believed beforehand.

    sigma_m: how far each receiver wanders per axis at the least (standard deviation); sigma_spread:
    of its logarithm; tau_s: correlation time of what velocities leave of that, unless it is
    forgotten quickly (`receivers.QUICKLY_S`); height_sigma_m, height_tau_s: how far each vehicle's
    height wanders, and its correlation time.
    """

    sigma_m: float = 0.8
    sigma_spread: float = 0.8
    tau_s: float = REST_FORGETS_S
    height_sigma_m: float = 0.5
    height_tau_s: float = FORGETS_S
    deaf_share: float = 0.02


# Two receivers, and two barometers, between which no sonar measures.
UNRANGED_SIGMA_M = math.sqrt(2.0) * Wandering().sigma_m
UNRANGED_UP_SIGMA_M = math.sqrt(2.0) * Wandering().height_sigma_m


@dataclass(frozen=True, slots=True)
class Bystander:
    """Another vehicle that the sonar may hear.

    system_id: its own. to_it_m: from the follower, (north, east, up), by the receiver of whom the
    sonar looks at, so that a guess moves it as it moves that one; where not `moves`, by the
    follower's own. sigma_m, up_sigma_m: how unsure the way from that receiver to its own is,
    standard deviation, and that of their heights.
    """

    system_id: int
    to_it_m: Between
    sigma_m: float
    up_sigma_m: float
    moves: bool = True


class Cloud:
    """Leader's minus follower's position error, (north, east, up) metres, with its uncertainty."""

    def __init__(self, sonar: SonarBelief, wandering: Wandering | None = None) -> None:
        wandering = wandering or Wandering()
        self._sonar = sonar
        self._range_sigma_m = math.hypot(PLACED_SIGMA_M, sonar.noise_m)
        self._chance = chance = np.random.Generator(np.random.PCG64(0))
        count = GUESSES
        self._receivers = Receivers(wandering.sigma_m, wandering.sigma_spread, wandering.tau_s)
        # A guess, as its opposite, always has the same place among the cells of `receivers`.
        self._place = np.tile(chance.random(count // 2), 2)
        # Of a pair: the difference of two that wander alike.
        self._height_sigma_m = math.sqrt(2.0) * wandering.height_sigma_m
        self._height_tau_s = wandering.height_tau_s
        self._share_out()
        # The sonar: between the narrowest and the widest beam that are believed, between how far it
        # hears surely and at most, and as a share of how often it hears at the least.
        self._wide, self._far = chance.random(count), chance.random(count)
        self._hears = chance.uniform(*HEARS, count)
        self._deaf = chance.random(count) < wandering.deaf_share
        # By how much another vehicle is not where it is taken to be, (north, east, up), as a share
        # of what is unsure of it; by its system id.
        self._astray: dict[int, Array] = {}
        self._weight = np.full(count, 1.0 / count)
        # What both receivers' drift differs by.
        self._drift = self._scattered(self._wanders_m)
        # What their autopilots' beliefs differ by, which follow the drift.
        self._off = self._drift.copy()
        # By what chance it is foretold: always the same, so that asking twice gives one answer.
        self._ahead = self._opposites()
        # How many of its readings are wrong: between `WRONG`, by the logarithm.
        self._wrong = chance.random(count)
        self._advanced_s: float | None = None
        self._then_s = -math.inf
        self._heard_at_s = self._found_at_s = -math.inf
        self._silent_at_s = -math.inf
        self._silent_since_s: float | None = None
        self._asked: tuple[Horizontal, float, float] | None = None
        self._nearest_m = 0.0
        self._summarise()

    def turn_to(self, off: Off) -> None:
        """Be of another leader, of which is known so much; what is learnt of the sonar stays."""
        self._astray.clear()
        self._repeat(self._weight)
        # As far as its receivers wander, each guess has more or less of it.
        wanders_m = self._wanders_m / np.sqrt(self._wanders_m**2 @ self._weight)[:, np.newaxis]
        *off_m, level_sigma_m, up_sigma_m = off
        sigma_m = np.array(((level_sigma_m,), (level_sigma_m,), (up_sigma_m,)))
        self._off = np.array(off_m)[:, np.newaxis] + self._scattered(sigma_m * wanders_m)
        self._drift = self._off.copy()
        self._receivers.turn_to((off.north_m, off.east_m), level_sigma_m)
        self._heard_at_s = self._found_at_s = self._silent_at_s = -math.inf
        self._silent_since_s = None
        self._summarise()

    def copy(self) -> "Cloud":
        """What is known now, for later."""
        return copy.deepcopy(self)

    # ---- what is known ----

    @property
    def has_heard(self) -> bool:
        """Whether there was a reading that was the leader's."""
        return math.isfinite(self._heard_at_s)

    @property
    def off(self) -> Off:
        """What both positions disagree by, less the drift and jumps that reports have shown."""
        return Off(self.north_m, self.east_m, self.up_m, self.level_sigma_m, self.up_sigma_m)

    def unheard_s(self, now_s: float) -> float:
        """Time since the last reading that was the leader's; infinite at first."""
        return now_s - self._heard_at_s

    def found_s(self, now_s: float) -> float:
        """For how long the leader has been heard, with no silence of `LOST_S`; 0: it is not."""
        return now_s - self._found_at_s if self.unheard_s(now_s) <= LOST_S else 0.0

    def sigma_m(self, direction_rad: float) -> float:
        """Standard deviation of the estimate along a bearing."""
        cos, sin = math.cos(direction_rad), math.sin(direction_rad)
        p_nn, p_ne, p_ee = self._covariance
        return math.sqrt(max(0.0, p_nn * cos * cos + 2.0 * p_ne * cos * sin + p_ee * sin * sin))

    @property
    def deaf_share(self) -> float:
        """How likely the sonar is deaf."""
        return float(self._weight @ self._deaf)

    @property
    def wander_m(self) -> float:
        """How far each receiver wanders per axis, standard deviation, as learnt, less `drift`."""
        return float(self._receivers.share @ self._receivers.sigma_m)

    @property
    def forgets_s(self) -> float:
        """In how long they forget that (correlation time), as learnt."""
        return float(self._receivers.share @ self._receivers.tau_s)

    def nearest_m(self, to_it_m: Horizontal, above_m: float, clear_m: float) -> float:
        """How near one may come, on the straight way, to where the leader is believed (`RISK`).

        From there it is certain that the leader is no nearer than `clear_m`. to_it_m, above_m: from
        here to where it is believed, (north, east), and up by both vehicles' own heights; a leader
        behind here is nobody to fly at.
        """
        asked = to_it_m, above_m, clear_m
        if asked != self._asked:  # the plan and the envelope mostly ask the same
            self._asked = asked
            self._nearest_m = max(self._find_nearest_m(*asked), self._if_deaf_m(*asked))
        return self._nearest_m

    def _find_nearest_m(self, to_it_m: Horizontal, above_m: float, clear_m: float) -> float:
        far_m = math.hypot(*to_it_m)
        cos, sin = to_it_m[0] / max(far_m, CLOSE_M), to_it_m[1] / max(far_m, CLOSE_M)
        # From where it is believed to where a guess has it: towards here, and across. Past a leader
        # that is further across one may come nearer.
        north, east = self._around
        nearer = north * cos
        nearer += east * sin
        across = east * cos
        across -= north * sin
        across *= across
        up = above_m - self._then[2]
        up *= up
        reach_m2 = clear_m * clear_m - across
        reach_m2 -= up
        there = np.flatnonzero((reach_m2 > 0.0) & (nearer < far_m))
        room_m, weight = nearer[there] + np.sqrt(reach_m2[there]), self._weight[there]
        if float(weight.sum()) <= RISK:
            return 0.0
        # The furthest are enough: mostly one in six.
        likely = np.flatnonzero(room_m > 0.25 * room_m.max() + 0.75 * room_m.mean())
        if float(weight[likely].sum()) > 2.0 * RISK:
            room_m, weight = room_m[likely], weight[likely]
        furthest = np.argsort(-room_m)
        place = int(np.searchsorted(np.cumsum(weight[furthest]), RISK, side="right"))
        return max(0.0, float(room_m[furthest[min(place, len(furthest) - 1)]]))

    def _if_deaf_m(self, to_it_m: Horizontal, above_m: float, clear_m: float) -> float:
        """The same in the level, by guesses that hold the sonar for deaf, once it has been silent.

        Silence makes a leader near by unlikely only if the sonar hears. No further than it would
        be heard from where they have it: so a sonar that hears still finds it.
        """
        since_s = self._silent_since_s
        if since_s is None or self._silent_at_s - since_s < SILENT_S:
            return 0.0
        weight = self._weight * self._deaf
        share = float(weight.sum())
        if share <= 0.0:
            return 0.0
        up_m = above_m - float(weight @ self._then[2]) / share
        if abs(up_m) > clear_m + SURE_SIGMAS * self.up_sigma_m:
            return 0.0
        far_m, (north, east) = max(math.hypot(*to_it_m), CLOSE_M), self._around
        nearer = (north * to_it_m[0] + east * to_it_m[1]) / far_m
        mean_m = float(weight @ nearer) / share
        sigma_m = math.sqrt(float(weight @ (nearer - mean_m) ** 2) / share)
        heard_m = self._sonar.heard_to_m + self._sonar.inset_m
        return mean_m + min(heard_m, clear_m + SURE_SIGMAS * sigma_m)

    # ---- what is learnt ----

    def foretell(self, then_s: float) -> None:
        """Let all that is asked from now on be of `then_s`."""
        self._then_s = then_s
        self._summarise()

    def advance(self, to_s: float) -> None:
        """Let the guesses wander until `to_s`."""
        if self._wandered(to_s):
            self._summarise()

    def _wandered(self, to_s: float) -> bool:
        """Let them wander, unless that is soon after the last time: whether they did."""
        if self._advanced_s is None:
            self._advanced_s = to_s
        elapsed_s = to_s - self._advanced_s
        if elapsed_s < UPDATE_PERIOD_S:
            return False
        self._advanced_s = to_s
        self._receivers.wander(elapsed_s)
        self._share_out()
        self._off, self._drift = self._moved(elapsed_s, self._opposites())
        for who, astray in self._astray.items():
            kept, new = self._drifted(elapsed_s, astray, self._normal(3))
            self._astray[who] = kept + new
        changes = self._chance.random(GUESSES)
        mixed = -math.expm1(-elapsed_s * (1.0 / DEAFENS_S + 1.0 / RECOVERS_S))
        deaf_share = RECOVERS_S / (DEAFENS_S + RECOVERS_S)
        deafens, recovers = mixed * deaf_share, mixed * (1.0 - deaf_share)
        self._deaf = np.where(self._deaf, changes > recovers, changes < deafens)
        others = np.flatnonzero(self._chance.random(GUESSES) < elapsed_s / DEAFENS_S)
        self._wrong[others] = self._chance.random(len(others))
        return True

    def _moved(self, elapsed_s: float, chance: Array) -> tuple[Array, Array]:
        """What autopilots believe after so long, and the drift that they follow.

        Height counts as following its barometer as soon as the place follows its receiver; EKF3's
        takes twice as long (tests/sitl/follows.py).
        """
        left, part = passing(elapsed_s, FOLLOWS_S)
        drift, change = self._drifted(elapsed_s, self._drift, self._wanders_m * chance)
        off = left * self._off
        off += (1.0 - left) * drift
        off += part * change
        drift += change
        return off, drift

    def _drifted(self, elapsed_s: float, drift: Array, chance: Array) -> tuple[Array, Array]:
        """What is kept of a drift, (north, east, up) of each guess, and what of `chance` is new."""
        level = np.exp(-elapsed_s / self._receivers.tau_s)
        up = math.exp(-elapsed_s / self._height_tau_s)
        return (
            _scaled(level[self._cell], up, drift),
            _scaled(np.sqrt(1.0 - level * level)[self._cell], math.sqrt(1.0 - up * up), chance),
        )

    def _share_out(self) -> None:
        """Put as many guesses into each cell of `receivers` as it is likely."""
        up_to = np.cumsum(self._receivers.share)
        self._cell = np.minimum(np.searchsorted(up_to, self._place), len(up_to) - 1)
        level_m = math.sqrt(2.0) * self._receivers.sigma_m[self._cell]
        # How far each guess's drift goes, (north, east, up): standard deviations.
        self._wanders_m = np.stack((level_m, level_m, np.full(GUESSES, self._height_sigma_m)))

    def heard(
        self,
        time_s: float,
        distance_m: float,
        axis: Axis,
        believed: Between,
        others: Sequence[Bystander] = (),
    ) -> None:
        """Take a sonar reading.

        Args:
            time_s: when it was taken.
            distance_m: between the two vehicles' centres, by the sonar.
            axis: the sonar looked along it.
            believed: from follower to leader by their own positions, (north, east, up) metres.
            others: whose echo it may be instead.

        """
        if time_s - self._heard_at_s < UPDATE_PERIOD_S:
            return
        self._wandered(time_s)
        fits, of_others = self._explained(distance_m, axis, believed, others)
        wrong_share = self._wrong_share()
        fits *= 1.0 - wrong_share
        of_others *= 1.0 - wrong_share
        wrong = wrong_share / self._sonar.reach_m
        of_leader = float(self._weight @ (fits - wrong))
        of_another = float(self._weight @ of_others)
        if of_leader > of_another:
            if self.unheard_s(time_s) > LOST_S:
                self._found_at_s = time_s
            self._heard_at_s = time_s
            self._silent_since_s = None
            self._compare(distance_m, believed, float(self._weight @ wrong))
        self._update(fits + of_others + wrong)
        if of_leader + of_another <= 0.0 and self.found_s(time_s) < SURE_AFTER_S:
            self._guess_stepped(distance_m, axis, believed)

    def _compare(self, distance_m: float, believed: Between, wrong_per_m: float) -> None:
        """Show `receivers` what they disagree by along the way to the leader."""
        north_m, east_m, up_m = np.array(believed) - self._off @ self._weight
        far_m = math.hypot(north_m, east_m)
        if far_m < CLOSE_M or abs(up_m) >= distance_m:
            return
        along = north_m / far_m, east_m / far_m
        seen_m = math.sqrt(distance_m * distance_m - up_m * up_m)
        off_m = believed[0] * along[0] + believed[1] * along[1] - seen_m
        self._receivers.take(along, off_m, self._range_sigma_m, wrong_per_m)

    def is_of_another(
        self, distance_m: float, axis: Axis, believed: Between, others: Sequence[Bystander]
    ) -> bool:
        """Whether a range is rather one of the others'; arguments as for `heard`."""
        if not others:
            return False
        fits, of_others = self._explained(distance_m, axis, believed, others)
        return float(self._weight @ (of_others - fits)) > 0.0

    def _explained(
        self, distance_m: float, axis: Axis, believed: Between, others: Sequence[Bystander]
    ) -> tuple[Array, Array]:
        """How likely each guess makes a range: of whom the sonar looks at, of one of the others."""
        far_m, heard = self._seen(axis, believed, others)
        # Of two that are heard the nearer one's echo is the one that is reported.
        hidden = heard[:, np.newaxis] * (far_m[:, np.newaxis] < far_m)
        density = self._density(far_m, distance_m) * heard * np.prod(1.0 - hidden, axis=0)
        return density[0], density[1:].sum(axis=0)

    def _seen(
        self, axis: Axis, believed: Between, others: Sequence[Bystander]
    ) -> tuple[Array, Array]:
        """How far each vehicle is, by each guess, and how likely it is heard, were it alone.

        Both have the shape (vehicles, guesses); the first is whom the sonar looks at.
        """
        to_it = np.array(believed)[:, np.newaxis] - self._off
        seen = [self._detected(axis, to) for to in (to_it, *map(self._to_other, others))]
        far_m, heard = map(np.array, zip(*seen, strict=True))
        return far_m, heard

    def _to_other(self, other: Bystander) -> Array:
        """Where each guess has another vehicle, by itself and by what is unsure of that one.

        A guess keeps the latter, as it is the same from reading to reading: one that is unsure is
        heard where it is again and again, as whom the sonar looks at.
        """
        if other.system_id not in self._astray:
            self._astray[other.system_id] = self._opposites()
        to_it: Array = np.array(other.to_it_m)[:, np.newaxis] - other.moves * self._off
        unsure_m = np.array((other.sigma_m, other.sigma_m, other.up_sigma_m))[:, np.newaxis]
        to_it += unsure_m * self._astray[other.system_id]
        return to_it

    def _wrong_share(self) -> Array:
        """How many of its readings are wrong, for each guess."""
        least, most = WRONG
        share: Array = least * (most / least) ** self._wrong
        return share

    def _density(self, far_m: Array, distance_m: float) -> Array:
        """Of a range, with a vehicle so far away."""
        sigma_m = self._range_sigma_m
        density: Array = np.exp(-0.5 * ((far_m - distance_m) / sigma_m) ** 2)
        return density / (sigma_m * math.sqrt(2.0 * math.pi))

    def _guess_stepped(self, distance_m: float, axis: Axis, believed: Between) -> None:
        """Put a few guesses where a range says the leader is, though none had foretold it.

        The next readings show whether the receivers disagree by so much (`STEPPED`).
        """
        count = round(STEPPED * GUESSES)
        half_rad = 0.5 * self._sonar.widest_rad.at(distance_m)
        aside, above, far = self._chance.standard_normal((3, count))
        azimuth = axis.azimuth_rad + half_rad * aside
        elevation = axis.elevation_rad + half_rad * above
        far = distance_m + self._range_sigma_m * far
        level = far * np.cos(elevation)
        to_it = np.array(
            (level * np.cos(azimuth), level * np.sin(azimuth), far * np.sin(elevation))
        )
        them = self._chance.choice(GUESSES, count, replace=False)
        self._off[:, them] = self._drift[:, them] = np.array(believed)[:, np.newaxis] - to_it
        self._deaf[them] = False
        self._weight[them] = 1.0 / GUESSES
        self._weight /= self._weight.sum()
        self._summarise()

    def silent(
        self, time_s: float, axis: Axis, believed: Between, others: Sequence[Bystander] = ()
    ) -> None:
        """Take a reading without an echo, of anybody; arguments as for `heard`."""
        if time_s - max(self._silent_at_s, self._heard_at_s) < UPDATE_PERIOD_S:
            return
        if not self._may_be_heard(believed):
            self._silent_since_s = None
        elif self._silent_since_s is None or time_s - self._silent_at_s > LOST_S:
            self._silent_since_s = time_s
        self._silent_at_s = time_s
        self._wandered(time_s)
        _, heard = self._seen(axis, believed, others)
        self._update((1.0 - self._wrong_share()) * np.prod(1.0 - heard, axis=0))

    def _may_be_heard(self, believed: Between) -> bool:
        """Whether the leader may be within the sonar's reach, so that silence says anything."""
        far_m = math.hypot(believed[0] - self.north_m, believed[1] - self.east_m)
        reach_m = self._sonar.reach_m + self._sonar.inset_m
        return far_m < reach_m + SURE_SIGMAS * self.level_sigma_m

    def _detected(self, axis: Axis, to_it: Array) -> tuple[Array, Array]:
        """How far a vehicle there is, for each guess, and how likely it is heard."""
        sonar = self._sonar
        far_m = np.sqrt((to_it * to_it).sum(axis=0))
        north, east, down = axis.unit_ned
        ahead = np.array((north, east, -down)) @ to_it / np.maximum(far_m, PLACED_SIGMA_M)
        off_rad = np.arccos(np.clip(ahead, -1.0, 1.0))
        narrowest = sonar.narrowest_rad.at(far_m)
        half_rad = narrowest + self._wide * (sonar.widest_rad.at(far_m) - narrowest)
        beyond = np.minimum((off_rad - half_rad) / (0.5 * sonar.edge_rad), 80.0)
        to_m = sonar.surely_to_m + self._far * (sonar.reach_m - sonar.surely_to_m)
        share = np.minimum(MOST_HEARD, self._hears * sonar.heard.at(far_m))
        share = share * (far_m < to_m + sonar.inset_m) * ~self._deaf
        return far_m, share / (1.0 + np.exp(beyond))

    def _update(self, likelihood: Array) -> None:
        self._weight *= likelihood
        self._weight /= self._weight.sum()
        root = np.sqrt(self._weight)
        if float(root.sum()) ** 2 < 0.5 * GUESSES:
            self._repeat(root / root.sum())
        self._summarise()

    def _repeat(self, often: Array) -> None:
        """Repeat each guess so often, with small changes (systematic resampling).

        often: shares of all; the weights make up for what they differ by from those.
        """
        places = (np.arange(GUESSES) + self._chance.random()) / GUESSES
        chosen = np.minimum(np.searchsorted(np.cumsum(often), places), GUESSES - 1)
        self._weight = self._weight[chosen] / often[chosen]
        self._weight /= self._weight.sum()
        moves_m = MOVES_M * self._normal(3)
        self._off, self._drift = self._off[:, chosen] + moves_m, self._drift[:, chosen] + moves_m
        self._wide = np.clip(self._changed(self._wide[chosen]), 0.0, 1.0)
        self._far = np.clip(self._changed(self._far[chosen]), 0.0, 1.0)
        self._wrong = np.clip(self._changed(self._wrong[chosen]), 0.0, 1.0)
        self._hears = np.clip(self._changed(self._hears[chosen]), *HEARS)
        self._deaf = self._deaf[chosen]
        self._astray = {who: astray[:, chosen] for who, astray in self._astray.items()}

    def _changed(self, values: Array) -> Array:
        """Nearer to their mean, and scattered by as much: the spread stays."""
        mean = float(self._weight @ values)
        off = values - mean
        spread = math.sqrt(float(self._weight @ (off * off)))
        off *= KEPT_OF_SPREAD
        off += mean
        off += NEW_OF_SPREAD * spread * self._normal(1)[0]
        return off

    def _scattered(self, sigma_m: Array) -> Array:
        """Around nought, as many as the root of how likely each is, and weigh them by the rest."""
        drawn = math.sqrt(2.0) * self._opposites()
        self._weight *= np.exp(-0.25 * (drawn * drawn).sum(axis=0))
        self._weight /= self._weight.sum()
        return sigma_m * drawn

    def _opposites(self) -> Array:
        """Each with its opposite: so their mean is none."""
        half = self._chance.standard_normal((3, GUESSES // 2))
        return np.concatenate((half, -half), axis=1)

    def _normal(self, rows: int) -> Array:
        drawn: Array = self._chance.standard_normal((rows, GUESSES))
        return drawn

    def _summarise(self) -> None:
        """Mean and covariance of the guesses."""
        self._asked = None
        ahead_s = 0.0 if self._advanced_s is None else self._then_s - self._advanced_s
        self._then = then = self._off
        if ahead_s > 0.0:
            self._then = then = self._moved(ahead_s, self._ahead)[0]
        self.north_m, self.east_m, self.up_m = map(float, then @ self._weight)
        self._around = north, east = then[0] - self.north_m, then[1] - self.east_m
        up = then[2] - self.up_m
        weight = self._weight
        self._covariance: tuple[float, float, float] = (
            float(weight @ (north * north)),
            float(weight @ (north * east)),
            float(weight @ (east * east)),
        )
        self.up_sigma_m = math.sqrt(float(weight @ (up * up)))
        self.level_sigma_m = max(self.sigma_m(0.0), self.sigma_m(math.pi / 2.0))
        """The larger of the standard deviations to the north and to the east."""


def _scaled(level: Array, up: float, values: Array) -> Array:
    """Values, (north, east, up) of each guess, times this of each, level and up."""
    scaled = np.empty_like(values)
    np.multiply(values[:2], level, out=scaled[:2])
    np.multiply(values[2], up, out=scaled[2])
    return scaled
