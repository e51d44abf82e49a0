"""What a formation costs: its worst pair's uncertainty, and what it lacks of its limits. Pure."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from echowing.errors import EchowingError
from echowing.flight.belief import SonarBelief
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import LEAST_M, SURE_SIGMAS
from echowing.flight.formation import IN_SLOT_M, sonars_demand_m
from echowing.flight.guidance import Slot
from echowing.flight.shapes import MOST_FOLLOWERS
from echowing.planning.ties import (
    ALONG_SIGMA_M,
    LEADER,
    Array,
    Geometry,
    Sight,
    in_the_way_m,
    out_of_sight_m,
    pair_links,
    pair_sigma_m,
    tie_sigma_m,
    watched,
    without_spare_m,
)

MOST_SHARE = math.nextafter(1.0, 0.0)
# A centimetre off a limit is on it.
ON_LIMIT_M = 0.01
# How far apart `follow` wants two slots by the sonars between them (one: it measures the distance
# itself). A centimetre off that limit is on it, and a file's millimetres take another one.
DEMANDED_M = np.array(
    [0.0, 0.0]
    + [sonars_demand_m(LEAST_M, links) + 2.0 * ON_LIMIT_M for links in range(2, MOST_FOLLOWERS + 1)]
)
# What a metre off a limit costs, and a metre that a spare is off: so much more than a metre of
# uncertainty that neither pays. The mean of all pairs decides between formations that are alike.
LIMIT_COST, SPARE_COST, MEAN_COST = 100.0, 10.0, 0.05


@dataclass(frozen=True, slots=True)
class Limits:
    """What a formation has to keep.

    spacing_m: the least distance between any two, and the greatest to who is watched. angle_rad:
    how far off the tail of who is watched a slot may be. view_rad: how far to each side of the
    course the gimbal looks after a loss, tilt_rad: up and down. keep_out_rad: nobody within
    this of the leader's nose. heights_m: the altitude steps that are allowed. leader_only: every
    sonar watches the leader.
    """

    followers: int
    sonar: SonarBelief
    spacing_m: tuple[float, float] = (3.0, 3.5)
    # With 45 spares are seldom found for five; with 60 more followers were far off in flight.
    angle_rad: float = math.radians(50.0)
    view_rad: float = math.radians(60.0)
    tilt_rad: float = math.radians(30.0)
    keep_out_rad: float = math.radians(90.0)
    heights_m: tuple[float, ...] = (0.0,)
    leader_only: bool = False

    def check(self) -> None:
        """Raise EchowingError where nobody could keep them."""
        least_m, most_m = self.spacing_m
        if not 1 <= self.followers <= MOST_FOLLOWERS:
            raise EchowingError(f"{self.followers} followers: give 1 to {MOST_FOLLOWERS}")
        if not LEAST_M <= least_m <= most_m:
            raise EchowingError(
                f"spacing {least_m:g}-{most_m:g}: give the least, {LEAST_M:g} m or more, then the "
                "greatest"
            )
        for name, angle_rad, (low_deg, high_deg) in (
            ("angle", self.angle_rad, (1.0, 90.0)),
            ("view", self.view_rad, (1.0, 90.0)),
            ("tilt", self.tilt_rad, (0.0, 90.0)),
            ("keep-out", self.keep_out_rad, (90.0, 179.0)),
        ):
            if not low_deg <= round(math.degrees(angle_rad), 6) <= high_deg:
                raise EchowingError(
                    f"{name} {math.degrees(angle_rad):g}: give {low_deg:g} to {high_deg:g} degrees"
                )
        for range_m in self.spacing_m:
            if (why := self.sonar.objection(range_m)) is not None:
                raise EchowingError(f"spacing {range_m:g} m: the sonar does not carry it: {why}")

    @property
    def sight(self) -> Sight:
        """Whom a sonar may watch in its slot."""
        return Sight(self.spacing_m, self.angle_rad, self.tilt_rad, self.sonar.widest_rad)

    @property
    def spare_sight(self) -> Sight:
        """Whom it is certain to hear after a loss."""
        sonar = self.sonar
        range_m = sonar.shortest_m + sonar.inset_m, sonar.heard_to_m + sonar.inset_m
        return Sight(range_m, self.view_rad, self.tilt_rad, sonar.widest_rad)

    @property
    def unknowns(self) -> int:
        """How many shares of 0 to 1 describe a formation."""
        return self.followers * (3 if len(self.heights_m) == 1 else 4)

    def places_m(self, shares: Array) -> Array:
        """Places (back, right, up) from shares of 0 to 1: the leader's, then from front to back.

        Of each follower: behind whom of those placed before, in which direction, how far, how high.
        So somebody is in reach of everybody, whatever the shares.
        """
        each = np.clip(shares, 0.0, MOST_SHARE).reshape(-1, self.followers)
        least_m, most_m = self.spacing_m
        far_m = least_m + each[2] * (most_m - least_m)
        angle_rad = (2.0 * each[1] - 1.0) * self.angle_rad
        steps = each[3] * len(self.heights_m) if len(each) > 3 else np.zeros(self.followers)
        places = np.zeros((self.followers + 1, 3))
        places[1:, 2] = np.array(self.heights_m)[steps.astype(int)]
        for one in range(1, self.followers + 1):
            its = 0 if self.leader_only else int(each[0, one - 1] * one)
            above_m = places[one, 2] - places[its, 2]
            level_m = math.sqrt(max(0.0, far_m[one - 1] ** 2 - above_m**2))
            back, right = math.cos(angle_rad[one - 1]), math.sin(angle_rad[one - 1])
            places[one, :2] = places[its, :2] + level_m * np.array((back, right))
        return places[np.argsort(places[:, 0], kind="stable")]


@dataclass(frozen=True)
class Formation:
    """Places within limits, and what follows from them."""

    places_m: Array
    limits: Limits

    @cached_property
    def geometry(self) -> Geometry:
        """Who is where from whom."""
        return Geometry.of(self.places_m)

    @cached_property
    def _blocked_m(self) -> Array:
        return in_the_way_m(self.geometry, self.limits.sight)

    @cached_property
    def off_m(self) -> Array:
        """[i, j]: how many metres j is off being watched by i; 0: it may be."""
        off_m: Array = out_of_sight_m(self.geometry, self.limits.sight)
        off_m += self._blocked_m.sum(axis=2)
        if self.limits.leader_only:
            off_m[:, LEADER + 1 :] = np.inf
        return off_m

    @cached_property
    def tie_m(self) -> Array:
        """[i, j]: standard deviation of the sonar of i on j, or of receivers where it sees none."""
        return np.where(
            self.off_m <= ON_LIMIT_M, tie_sigma_m(self.geometry.far_m), UNRANGED_SIGMA_M
        )

    @cached_property
    def watches(self) -> list[int]:
        """Whom the sonars of followers 1 to N watch."""
        return watched(self.off_m, self.tie_m)

    @cached_property
    def sigma_m(self) -> Array:
        """[i, j]: how sure what is known of two is."""
        return pair_sigma_m(self.watches, self.tie_m)

    @cached_property
    def certain_m(self) -> Array:
        """[i, j]: the distance that is certain while each follower is in its slot.

        Of two that are tied the sonar measures just this distance.
        """
        unsure_m = self.sigma_m.copy()
        for one, its in enumerate(self.watches, 1):
            if self.tie_m[one, its] < UNRANGED_SIGMA_M:
                unsure_m[one, its] = unsure_m[its, one] = ALONG_SIGMA_M
        in_slot_m = np.full(len(unsure_m), IN_SLOT_M)
        in_slot_m[LEADER] = 0.0
        off_slot_m = in_slot_m[:, np.newaxis] + in_slot_m
        certain: Array = self.geometry.far_m - SURE_SIGMAS * unsure_m - off_slot_m
        return certain

    @cached_property
    def _demanded_m(self) -> Array:
        """[i, j]: how far apart `follow` wants them, whoever wrote the slots down."""
        demanded: Array = DEMANDED_M[pair_links(self.watches)]
        return demanded

    @cached_property
    def _spare_off_m(self) -> Array:
        sight = self.limits.spare_sight
        off_m: Array = out_of_sight_m(self.geometry, sight) + self._blocked_m.sum(axis=2)
        return off_m

    @cached_property
    def missing_spare_m(self) -> Array:
        """[i, k]: how many metres i lacks to watch somebody once follower k is lost."""
        return without_spare_m(self._spare_off_m, self._blocked_m)

    def spare(self, one: int) -> int | None:
        """Whom a follower watches once the follower that it watches is lost; None: nobody."""
        its = self.watches[one - 1]
        if its == LEADER or self.missing_spare_m[one, its] > ON_LIMIT_M:
            return None
        left_m = self._spare_off_m[one, :one] - self._blocked_m[one, :one, its]
        left_m[its] = np.inf
        return int(left_m.argmin())

    @cached_property
    def off_limits_m(self) -> dict[str, float]:
        """How many metres in all each limit is missed by."""
        far_m, pairs = self.geometry.far_m, np.triu_indices(len(self.places_m), 1)
        back_m, right_m = self.places_m[1:, 0], self.places_m[1:, 1]
        ahead_rad = np.abs(np.arctan2(right_m, back_m)) - (math.pi - self.limits.keep_out_rad)
        watch_m = sum(self.off_m[one, its] for one, its in enumerate(self.watches, 1))
        return {
            "least spacing": float(np.maximum(0.0, self.limits.spacing_m[0] - far_m[pairs]).sum()),
            "certain distance": float(np.maximum(0.0, LEAST_M - self.certain_m[pairs]).sum()),
            "what follow demands": float(np.maximum(0.0, self._demanded_m - far_m)[pairs].sum()),
            "somebody to watch": float(watch_m),
            "keep-out": float((np.maximum(0.0, ahead_rad) * far_m[0, 1:]).sum()),
        }

    @property
    def is_within_limits(self) -> bool:
        """Whether it keeps them; a loss may still split it."""
        return sum(self.off_limits_m.values()) <= ON_LIMIT_M

    @property
    def left_alone(self) -> dict[int, list[int]]:
        """The followers whose loss leaves others with nobody to watch, and those."""
        missing = self.missing_spare_m > ON_LIMIT_M
        return {
            int(k): np.flatnonzero(missing[:, k]).tolist()
            for k in np.flatnonzero(missing.any(axis=0))
        }

    def slots(self) -> list[Slot]:
        """Its slots, each behind whom its sonar watches."""
        return [self._slot(one, its) for one, its in enumerate(self.watches, 1)]

    def _slot(self, one: int, its: int) -> Slot:
        back_m, right_m, _ = self.places_m[one] - self.places_m[its]
        return Slot(
            math.hypot(back_m, right_m),
            math.atan2(right_m, back_m),
            float(self.places_m[one, 2]),
            None if its == LEADER else its - 1,
        )

    @cached_property
    def cost(self) -> float:
        """To be least: standard deviation of the worst pair, in metres, and limits."""
        sigma_m = self.sigma_m[np.triu_indices(len(self.places_m), 1)]
        uncertain = float(sigma_m.max() + MEAN_COST * sigma_m.mean())
        off_m = sum(self.off_limits_m.values())
        spare_m = float(self.missing_spare_m.max(axis=1).sum())
        return uncertain + LIMIT_COST * off_m + SPARE_COST * spare_m
