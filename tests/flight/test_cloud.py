"""What the cloud learns from a sonar that looks along known axes, and what it never believes.

A figure's tolerance is the cloud's own grain: 4000 guesses of a spread of 2 m have a mean that is
off by 0.03 m, and the guesses of a flight's first readings are fewer.
"""

import math
import statistics
from collections.abc import Sequence

import numpy as np
import pytest

from echowing.flight.axis import Axis
from echowing.flight.clocks import LOST_S
from echowing.flight.cloud import (
    GUESSES,
    MOVES_M,
    RISK,
    SURE_AFTER_S,
    Between,
    Bystander,
    Cloud,
    Off,
    Wandering,
)
from echowing.flight.guidance import Horizontal
from echowing.flight.receivers import QUICK_SHARE, QUICKLY_S
from echowing.sonar_file import shipped_sonar

NORTH, EAST = 0.0, math.pi / 2
READING_S = 0.3  # over UPDATE_PERIOD_S: each reading is evidence of its own
FAR_M = 3.0


class Sonar:
    """Where the leader is, and what the follower's sonar makes of it as it looks round.

    true_m: leader's minus follower's position error, (north, east, up).
    """

    def __init__(self, true_m: Between = (0.0, 0.0, 0.0), half_deg: float = 17.0) -> None:
        self.cloud = Cloud(shipped_sonar())
        self.true_m, self.half_rad, self.now_s = true_m, math.radians(half_deg), 0.0

    def looks(
        self,
        axis: Axis,
        count: int = 1,
        to_it_m: Between = (FAR_M, 0.0, 0.0),
        *,
        deaf: bool = False,
    ) -> "Sonar":
        """`count` readings along an axis; to_it_m: where the leader truly is, north, east, up."""
        believed = tuple(a + b for a, b in zip(to_it_m, self.true_m, strict=True))
        north, east, up = to_it_m
        far_m = math.hypot(*to_it_m)
        ahead = axis.unit_ned
        off_rad = math.acos((north * ahead[0] + east * ahead[1] - up * ahead[2]) / far_m)
        for _ in range(count):
            self.now_s += READING_S
            if deaf or off_rad > self.half_rad or far_m > 4.5:
                self.cloud.silent(self.now_s, axis, believed)  # type: ignore[arg-type]
            else:
                self.cloud.heard(self.now_s, far_m, axis, believed)  # type: ignore[arg-type]
        return self

    def looks_round(
        self, rounds: int = 4, wide_deg: float = 20.0, *, deaf: bool = False
    ) -> "Sonar":
        """The leader's direction, then to each side, up and down."""
        for _ in range(rounds):
            for aside, above in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)):
                wide_rad = math.radians(wide_deg)
                self.looks(Axis(aside * wide_rad, above * wide_rad), deaf=deaf)
        return self

    @property
    def off_m(self) -> float:
        """How far the cloud's mean is from the truth, level."""
        cloud = self.cloud
        return math.dist((cloud.north_m, cloud.east_m), self.true_m[:2])


def test_at_first_nothing_is_known_but_how_far_receivers_wander() -> None:
    cloud = Cloud(shipped_sonar())

    assert math.hypot(cloud.north_m, cloud.east_m, cloud.up_m) < 0.05
    # 0.8 m each, and some more: four in ten wander further than that (test_receivers.py).
    wanted_m = 1.73 * 0.8 * math.sqrt(2.0)
    assert cloud.sigma_m(NORTH) == pytest.approx(wanted_m, rel=0.05)
    assert cloud.sigma_m(0.7) == pytest.approx(wanted_m, rel=0.05)
    assert cloud.up_sigma_m == pytest.approx(0.5 * math.sqrt(2.0), rel=0.05)
    assert cloud.unheard_s(5.0) == math.inf


@pytest.mark.parametrize("true_m", [(0.7, -0.3, 0.0), (-1.2, 0.4, 0.3), (2.0, 0.0, -0.4)])
def test_looking_to_all_sides_finds_the_offset(true_m: Between) -> None:
    sonar = Sonar(true_m).looks_round()

    assert sonar.off_m < 0.3
    assert max(sonar.cloud.sigma_m(NORTH), sonar.cloud.sigma_m(EAST)) < 0.5


def test_one_axis_tells_the_range_and_hardly_the_side() -> None:
    """An arc: the leader may be anywhere in the beam, up to 20 degrees to each side."""
    cloud = Sonar((0.8, 0.0, 0.0)).looks(Axis(NORTH), 12).cloud

    # The arc of a beam of 40 degrees is up to 0.18 m nearer than its middle.
    assert cloud.north_m == pytest.approx(0.8, abs=0.2)
    assert cloud.sigma_m(NORTH) < 0.5 * cloud.sigma_m(EAST)


def test_tilt_tells_the_height() -> None:
    """A leader a metre higher than its barometer says: heard where the axis is tilted up."""
    sonar = Sonar((0.0, 0.0, -1.0))
    for _ in range(6):
        sonar.looks(Axis(NORTH, math.radians(20.0)), to_it_m=(2.8, 0.0, 1.0))
        sonar.looks(Axis(NORTH, math.radians(-10.0)), to_it_m=(2.8, 0.0, 1.0))

    assert sonar.cloud.up_m == pytest.approx(-1.0, abs=0.35)
    assert sonar.cloud.up_sigma_m < 0.4


def test_silence_moves_the_leader_out_of_the_beam() -> None:
    """It was heard a little to the right; then nothing is heard straight ahead."""
    sonar = Sonar((0.0, -0.4, 0.0)).looks(Axis(math.radians(12.0)), 3)
    before_m = sonar.cloud.east_m

    sonar.looks(Axis(NORTH), 8, deaf=True)

    assert sonar.cloud.east_m < before_m - 0.2


def test_silence_far_off_says_nothing() -> None:
    sonar = Sonar().looks(Axis(NORTH), 20, to_it_m=(12.0, 0.0, 0.0))

    assert sonar.off_m < 0.1
    assert sonar.cloud.sigma_m(NORTH) > 1.1


def test_readings_too_near_in_time_are_one() -> None:
    once, often = Cloud(shipped_sonar()), Cloud(shipped_sonar())
    for number in range(4):
        for more in range(6):
            now_s = number * READING_S + more * 0.02
            often.heard(now_s, FAR_M, Axis(NORTH), (4.0, 0.0, 0.0))
        once.heard(number * READING_S, FAR_M, Axis(NORTH), (4.0, 0.0, 0.0))

    assert often.sigma_m(NORTH) == once.sigma_m(NORTH)


def test_a_wild_reading_moves_it_little_and_counts_for_none() -> None:
    sonar = Sonar().looks_round()
    heard_s, north_m = sonar.now_s, sonar.cloud.north_m

    sonar.cloud.heard(heard_s + 1.0, 1.2, Axis(NORTH), (FAR_M, 0.0, 0.0))

    assert sonar.cloud.north_m == pytest.approx(north_m, abs=0.1)
    assert sonar.cloud.unheard_s(heard_s + 1.0) >= 1.0


def test_what_was_learnt_is_forgotten_as_receivers_wander() -> None:
    sonar = Sonar((1.0, 0.0, 0.0)).looks_round()
    known_m = sonar.cloud.sigma_m(NORTH)
    for now_s in range(round(sonar.now_s) + 1, 600):
        sonar.cloud.advance(float(now_s))

    assert known_m < 0.3
    assert sonar.cloud.sigma_m(NORTH) > 1.0
    assert abs(sonar.cloud.north_m) < 0.2


# Readings of a leader 7 m from where the receivers have it: nobody had guessed that.
def test_readings_that_agree_are_believed_however_far_the_receivers_are_off() -> None:
    sonar = Sonar((6.0, -3.5, 0.0)).looks(Axis(NORTH), 12)

    assert sonar.off_m < 1.0
    assert sonar.cloud.unheard_s(sonar.now_s) == 0.0


def test_receivers_that_wander_further_are_learnt() -> None:
    """Ten minutes of receivers that are 4 m apart, now to one side, now to the other."""
    sonar = Sonar()
    before = sonar.cloud.wander_m
    for minute in range(10):
        sonar.true_m = (4.0 * math.cos(minute), 4.0 * math.sin(minute), 0.0)
        sonar.now_s += 30.0
        sonar.looks(Axis(NORTH), 6).looks_round(2)

    assert sonar.cloud.wander_m > 1.25 * before


def test_that_they_wander_less_is_not_believed() -> None:
    """Ten quiet minutes are no proof of a quiet eleventh; a leader would be lost for it."""
    sonar = Sonar()
    for _ in range(10):
        sonar.now_s += 60.0
        sonar.looks_round(2)

    assert sonar.cloud.wander_m >= Wandering().sigma_m


def test_a_disagreement_that_nobody_expects_leaves_all_as_likely_as_it_was() -> None:
    """One receiver is suddenly 80 m off: the readings win, and how far they wander stays known.

    Beyond 80 m guesses are drawn back to nought by more, from reading to reading, than they vary.
    """
    sonar = Sonar().looks_round()
    sonar.true_m = (80.0, 0.0, 0.0)
    sonar.now_s += 4.0
    sonar.looks(Axis(NORTH), 12)

    assert sonar.off_m < 1.0
    assert 0.8 < sonar.cloud.wander_m < 3.2


def test_minutes_without_a_report_make_no_sonar_deaf() -> None:
    """It falls deaf once in ten minutes, and hears again in one: one time in eleven it is deaf."""
    cloud = Sonar().looks_round().cloud

    cloud.advance(1000.0)

    assert cloud.deaf_share == pytest.approx(1.0 / 11.0, abs=0.02)


class TestForetold:
    """What is asked is of the moment that was named, not of the last reading."""

    def test_it_is_less_sure_than_what_is_known(self) -> None:
        """Two receivers of a metre: a random walk of 0.52 m; autopilots follow it later."""
        sonar = Sonar().looks_round()
        cloud, now_s = sonar.cloud, sonar.now_s
        known_m, mean_m = cloud.sigma_m(NORTH), cloud.north_m

        cloud.foretell(now_s + 4.0)

        assert 0.3 < math.sqrt(cloud.sigma_m(NORTH) ** 2 - known_m**2) < 0.5
        assert cloud.north_m == pytest.approx(mean_m, abs=0.1)

    def test_the_way_that_they_drift_goes_on(self) -> None:
        """Seen to drift apart by 0.2 m/s: they do for the time by which autopilots follow later."""
        sonar = Sonar()
        for _ in range(20):
            sonar.true_m = (sonar.true_m[0] + 0.2 * READING_S, 0.0, 0.0)
            sonar.looks(Axis(NORTH))
        known_m = sonar.cloud.north_m

        sonar.cloud.foretell(sonar.now_s + 1.0)

        assert 0.02 < sonar.cloud.north_m - known_m < 0.2

    def test_what_is_known_stays_as_it_is(self) -> None:
        one, other = Sonar().looks_round(), Sonar().looks_round()
        one.cloud.foretell(one.now_s + 5.0)
        one.looks_round(1), other.looks_round(1)
        one.cloud.foretell(one.now_s)

        assert (one.cloud.north_m, one.cloud.east_m) == (other.cloud.north_m, other.cloud.east_m)


class TestHowNearIsCertain:
    """`nearest_m`: from there the leader is no nearer than a metre, but for one case in 160."""

    @staticmethod
    def nearest_m(cloud: Cloud, to_it_m: Horizontal = (6.0, 0.0), above_m: float = 0.0) -> float:
        return cloud.nearest_m(to_it_m, above_m, 1.0)

    def test_at_first_it_is_as_far_as_receivers_demand(self) -> None:
        """Not 1 m and 2.5 standard deviations: of those that err most most are aside or above."""
        cloud = Cloud(shipped_sonar())

        assert 2.5 < self.nearest_m(cloud) < 1.0 + 2.5 * cloud.sigma_m(NORTH)

    def test_once_it_is_heard_it_is_near(self) -> None:
        """The clear metre, and 2.5 standard deviations of a decimetre or two."""
        assert self.nearest_m(Sonar().looks_round().cloud) < 1.8

    def test_a_sonar_that_works_and_hears_nothing_rules_out_what_is_near(self) -> None:
        """All round where a leader at 3 m could be, nothing is heard: it is further."""
        sonar, before_m = Sonar(), self.nearest_m(Cloud(shipped_sonar()), (3.5, 0.0))
        nearest_m = []
        for _ in range(4):  # less than `SILENT_S`
            for aside_deg in (-60, -40, -20, 0, 20, 40, 60):
                for above_deg in (-20, 0, 20):
                    axis = Axis(math.radians(aside_deg), math.radians(above_deg))
                    sonar.looks(axis, to_it_m=(3.5, 0.0, 0.0), deaf=True)
            behind_m = -sonar.cloud.north_m  # the mean has moved away; what counts is the place
            nearest_m.append(self.nearest_m(sonar.cloud, (3.5 + behind_m, 0.0)) - behind_m)

        # Those that are left are the deaf ones, one in ten: each time a few guesses decide.
        assert statistics.fmean(nearest_m[1:4]) < before_m - 0.8

    @pytest.mark.parametrize("heard_before", [False, True])
    def test_but_a_deaf_one_is_not_believed_for_long(self, heard_before: bool) -> None:
        """Once silent for `SILENT_S` it may be deaf: then the leader is where receivers have it.

        As far as it would be heard by one that is not deaf: 4.2 m.
        """
        sonar, nearest_m = Sonar(), []
        if heard_before:
            sonar.looks_round()
        for _ in range(30):
            sonar.looks_round(2, wide_deg=40.0, deaf=True)
            behind_m = -sonar.cloud.north_m
            nearest_m.append(self.nearest_m(sonar.cloud, (3.0 + behind_m, 0.0)) - behind_m)

        assert min(nearest_m[11:]) > 3.5
        assert max(nearest_m) < 4.4
        assert statistics.fmean(nearest_m[3:9]) < 3.2

    def test_nor_if_the_leader_is_far_above_or_was_out_of_reach_all_the_time(self) -> None:
        silent = Sonar().looks_round(20, wide_deg=40.0, deaf=True).cloud
        assert self.nearest_m(silent, (5.0, 0.0)) > 3.5
        assert self.nearest_m(silent, (5.0, 0.0), above_m=6.0) == 0.0
        far = Sonar().looks(Axis(NORTH), 120, to_it_m=(40.0, 0.0, 0.0))
        cloud = far.looks_round(8, wide_deg=40.0, deaf=True).cloud
        assert self.nearest_m(cloud, (3.0 - cloud.north_m, 0.0)) + cloud.north_m < 3.5

    def test_one_that_hears_again_is_believed_at_once(self) -> None:
        sonar = Sonar().looks_round(20, wide_deg=40.0, deaf=True)
        assert self.nearest_m(sonar.looks_round().cloud) < 1.8

    def test_what_is_above_or_behind_is_nobody_to_fly_at(self) -> None:
        cloud = Cloud(shipped_sonar())

        assert self.nearest_m(cloud, above_m=4.0) == 0.0
        assert self.nearest_m(cloud, to_it_m=(0.5, 0.0)) <= 1.5


def nearest_by_definition(cloud: Cloud, to_it_m: Horizontal, above_m: float) -> float:
    """`Cloud.nearest_m` with a metre of clearance, guess by guess, all of them sorted."""
    far_m = math.hypot(*to_it_m)
    north, east = to_it_m[0] / far_m, to_it_m[1] / far_m
    rooms: list[tuple[float, float]] = []
    for guess, weight in zip(cloud._off.T, cloud._weight, strict=True):
        off_n, off_e = guess[0] - cloud.north_m, guess[1] - cloud.east_m
        nearer, across = off_n * north + off_e * east, off_e * north - off_n * east
        reach_m2 = 1.0 - across * across - (above_m - guess[2]) ** 2
        if reach_m2 > 0.0 and nearer < far_m:
            rooms.append((nearer + math.sqrt(reach_m2), weight))
    nearest_m, left = 0.0, RISK
    for room_m, weight in sorted(rooms, reverse=True):
        nearest_m, left = max(0.0, room_m), left - weight
        if left < 0.0:
            return nearest_m
    return 0.0


@pytest.mark.parametrize("rounds", [0, 1, 4])
@pytest.mark.parametrize(
    ("to_it_m", "above_m"),
    [((FAR_M, 0.0), 0.0), ((0.0, -FAR_M), 0.5), ((0.7, 0.7), 0.0), ((-9.0, 4.0), 1.6)],
)
def test_the_nearest_place_is_found_among_the_furthest_guesses(
    rounds: int, to_it_m: Horizontal, above_m: float
) -> None:
    cloud = Sonar().looks_round(rounds).cloud
    wanted_m = nearest_by_definition(cloud, to_it_m, above_m)
    for _ in range(2):  # the second time it is remembered
        assert cloud.nearest_m(to_it_m, above_m, 1.0) == pytest.approx(wanted_m, abs=1e-12)


def test_the_nearest_place_is_found_anew_as_the_cloud_learns() -> None:
    sonar = Sonar()
    asked = (FAR_M, 0.0), 0.0, 1.0
    unknown_m = sonar.cloud.nearest_m(*asked)
    assert sonar.looks_round().cloud.nearest_m(*asked) < unknown_m - 0.5


@pytest.mark.parametrize("seed", range(8))
def test_an_echo_of_another_vehicle_is_told_from_the_leaders_wherever_receivers_put_both(
    seed: int,
) -> None:
    """The leader is 3 m north, another one 3 m east of it; receivers put both 1.5 m further north.

    Where the other is, is known from the leader: what is wrong of one is wrong of both. As soon as
    both have been heard there is one place for the leader.
    """
    cloud, off_m, other = between_two(seed)
    believed = 3.0 + off_m, 0.0, 0.0
    its_axis, its_range_m = Axis(math.pi / 4.0), math.hypot(3.0, 3.0)
    for number in range(60, 120):
        cloud.heard(0.3 * number, its_range_m, its_axis, believed, [other])
    assert (cloud.north_m, cloud.east_m) == pytest.approx((off_m, 0.0), abs=0.35)
    assert cloud.is_of_another(its_range_m, its_axis, believed, [other])
    assert not cloud.is_of_another(3.0, Axis(0.0), believed, [other])
    assert cloud.unheard_s(36.0) > 17.0, "none of them was the leader's"


def between_two(seed: int) -> tuple[Cloud, float, Bystander]:
    """A minute of echoes of what may be the leader, or another one 3 m east of it."""
    cloud, off_m, chance = Cloud(shipped_sonar()), 1.5, np.random.default_rng(seed)
    other = Bystander(3, (3.0 + off_m, 3.0, 0.0), 0.1, 0.0)
    for number in range(60):
        range_m = 3.0 + chance.normal(0.0, 0.02)
        axis = Axis(0.2 * math.sin(number + seed))
        cloud.heard(0.3 * number, range_m, axis, (3.0 + off_m, 0.0, 0.0), [other])
    return cloud, off_m, other


def test_an_echo_that_two_vehicles_explain_alike_makes_neither_more_likely() -> None:
    """Half of the guesses have the leader there, half the other one; 30 % of readings are wrong.

    An echo of the other, counted as always right, would make it 59 % that it is the other one.
    """
    cloud, is_other = Cloud(shipped_sonar()), np.arange(GUESSES) % 2 == 0
    cloud._off[:] = np.array(((1.5,), (0.0,), (0.0,)))
    cloud._off[1, is_other] = 3.0
    cloud._weight[:], cloud._wrong[:] = 1.0 / GUESSES, 1.0

    cloud.heard(0.0, 3.0, Axis(0.0), (4.5, 0.0, 0.0), [Bystander(3, (4.5, 3.0, 0.0), 0.0, 0.0)])

    assert cloud._weight[cloud._off[1] > 1.5].sum() == pytest.approx(0.5, abs=0.03)


def test_a_nearer_vehicle_hides_the_leader_and_another_alike() -> None:
    """The leader is at 3.0 m, one unsure by 0.3 m is, too, and a third is before both of them.

    It hides both alike: so the surer one explains the range better, as without the third.
    """
    cloud = Cloud(shipped_sonar())
    cloud.turn_to(Off(0.0, 0.0, 0.0, 0.1, 0.1))
    unsure = Bystander(3, (3.0, 0.0, 0.0), 0.3, 0.0, moves=False)
    before = Bystander(4, (1.5, 0.0, 0.0), 0.0, 0.0, moves=False)

    for others in ([unsure], [unsure, before]):
        assert not cloud.is_of_another(3.0, Axis(0.0), (3.0, 0.0, 0.0), others)


def test_what_is_unlikely_is_kept_until_readings_decide() -> None:
    """Guesses that are a ten-thousandth as likely as the rest stay a hundredth as many.

    Repeated as often as they are likely, none of them would be left, and a reading that only they
    foretell would come too late.
    """
    cloud = Cloud(shipped_sonar())
    unlikely = cloud._off[0] > -1.0  # so many that those left are too few guesses
    part = np.count_nonzero(unlikely) / np.count_nonzero(~unlikely)

    cloud._update(np.where(unlikely, 1e-4, 1.0))

    kept = cloud._off[0] > -1.0 + 3.0 * MOVES_M
    assert 0.005 * part < np.count_nonzero(kept) / len(kept) < 0.02 * part
    assert cloud._weight[kept].sum() == pytest.approx(1e-4 * part, rel=0.5)


def test_a_height_forgets_its_drift_sooner_than_a_place() -> None:
    """What is left of both after the time in which a height forgets: 1/e, and 1/e to the 60/90.

    One guess in five forgets its place in 25 s.
    """
    cloud, known = Cloud(shipped_sonar()), Wandering()
    cloud.turn_to(Off(2.0, 0.0, 2.0, 0.0, 0.0))

    cloud.advance(0.0)
    cloud.foretell(known.height_tau_s)

    assert cloud.up_m == pytest.approx(2.0 * math.exp(-1.0), abs=0.15)
    slowly, quickly = (math.exp(-known.height_tau_s / s) for s in (known.tau_s, QUICKLY_S))
    kept = (1.0 - QUICK_SHARE) * slowly + QUICK_SHARE * quickly
    assert cloud.north_m == pytest.approx(2.0 * kept, abs=0.08)


def test_how_long_it_has_been_heard_counts_from_the_last_longer_silence() -> None:
    sonar = Sonar().looks(Axis(NORTH), 10)
    assert sonar.cloud.found_s(sonar.now_s) == pytest.approx(9 * READING_S)
    sonar.looks(Axis(NORTH), 5, deaf=True).looks(Axis(NORTH), 1)
    assert sonar.cloud.found_s(sonar.now_s) == pytest.approx(15 * READING_S)
    assert sonar.cloud.found_s(sonar.now_s + LOST_S + 0.1) == 0.0
    sonar.looks(Axis(NORTH), 15, deaf=True).looks(Axis(NORTH), 1)
    assert sonar.cloud.found_s(sonar.now_s) == 0.0


def test_an_unforetold_echo_is_followed_up_until_the_leader_is_sure() -> None:
    """A leader that has just been found is another one, in truth; then the sonar hears it."""
    for heard_s, follows in ((SURE_AFTER_S - 2.0, True), (SURE_AFTER_S + 2.0, False)):
        sonar = Sonar().looks(Axis(NORTH), round(heard_s / READING_S))
        for _ in range(3):
            sonar.now_s += READING_S
            sonar.cloud.heard(sonar.now_s, 2.0, Axis(EAST), (FAR_M, 0.0, 0.0))
        north_m, east_m = FAR_M - sonar.cloud.north_m, -sonar.cloud.east_m
        assert (math.dist((north_m, east_m), (0.0, 2.0)) < 1.0) is follows


def test_an_echo_may_be_of_one_that_is_believed_out_of_reach_and_unsure() -> None:
    """The leader is 3 m north. Another is 7 m north, give or take 1.5 m, and is heard at 4.2 m."""
    cloud, believed = Cloud(shipped_sonar()), (3.0, 0.0, 0.0)
    for number in range(60):
        cloud.heard(0.3 * number, 3.0, Axis(0.2 * math.sin(number)), believed)
    for sigma_m, its in ((1.5, True), (0.2, False)):
        other = Bystander(3, (7.0, 0.0, 0.0), sigma_m, 0.0)
        assert cloud.is_of_another(4.2, Axis(0.0), believed, [other]) is its


def test_one_that_is_unsure_is_heard_where_it_is_again_and_again() -> None:
    """The leader is believed out of reach, another one near; the sonar hears 3.9 m again and again.

    The other one is half a metre nearer than it was taken to be, one standard deviation. For the
    leader it would be more than one of two receivers'. Were the other's error anew by chance for
    each reading, each would speak for the leader, and by now it would be certain.
    """
    cloud, believed = Cloud(shipped_sonar()), (5.5, 0.0, 0.0)
    other = Bystander(3, (4.4, 0.0, 0.0), 0.5, 0.0, moves=False)
    for number in range(60):
        cloud.heard(0.3 * number, 3.9, Axis(0.1 * math.sin(number)), believed, [other])
    assert math.isinf(cloud.unheard_s(18.0))
    assert abs(cloud.north_m) < 0.8
    assert cloud.sigma_m(0.0) > 1.0, "of the leader nothing is known yet"


def test_silence_speaks_against_any_vehicle_that_would_be_heard() -> None:
    """Who is looked for is out of reach, another one 3 m ahead: nobody is heard, for 6 s."""
    other = Bystander(3, (3.0, 0.0, 0.0), 0.1, 0.0, moves=False)
    deaf = []
    for others in ([], [other]):
        cloud = Cloud(shipped_sonar())
        for number in range(20):
            cloud.silent(0.3 * number, Axis(0.0), (8.0, 0.0, 0.0), others)
        deaf.append(cloud.deaf_share)
    assert deaf[0] < 0.1
    assert deaf[1] > 0.5, "nothing else explains it"


@pytest.mark.parametrize("before", [0, 1000])
def test_how_many_readings_are_wrong_is_learnt(before: int) -> None:
    """A stranger's sonar is heard: from then on a range alone moves the leader less.

    At first, or after five minutes without one.
    """
    moved_m = []
    for wrong in (False, True):
        sonar = Sonar().looks(Axis(NORTH), before)
        for number in range(40):
            sonar.looks(Axis(NORTH))
            if wrong and number % 2:
                sonar.now_s += READING_S
                sonar.cloud.heard(sonar.now_s, 1.0 + 0.05 * number, Axis(NORTH), (FAR_M, 0.0, 0.0))
        sonar.now_s += 60.0  # it is lost, and may be a metre off
        before_m, sonar.true_m = sonar.cloud.north_m, (1.0, 0.0, 0.0)
        sonar.looks(Axis(NORTH), to_it_m=(FAR_M - 1.0, 0.0, 0.0))
        moved_m.append(abs(sonar.cloud.north_m - before_m))

    assert moved_m[0] > 0.8
    assert moved_m[1] < 0.7 * moved_m[0]


@pytest.mark.parametrize(
    ("ranges_m", "every_s", "moves"),
    [((1.0, 2.6, 4.0), 1.0, False), ((2.5, 2.6, 2.4), 20.0, False), ((2.5, 2.6, 2.4), 1.0, True)],
)
def test_ranges_that_nothing_foretold_are_believed_where_they_agree_and_not_where_they_are_wild(
    ranges_m: Sequence[float], every_s: float, *, moves: bool
) -> None:
    """Of a leader that is believed 9 m away, and was never heard."""
    cloud, believed = Cloud(shipped_sonar()), (9.0, 0.0, 0.0)
    for number, range_m in enumerate(ranges_m):
        cloud.heard(5.0 + number * every_s, range_m, Axis(NORTH), believed)

    assert (cloud.north_m > 2.0) is moves


def test_echoes_of_another_vehicle_bring_nobody_to_where_it_is() -> None:
    """For 15 s, while the leader is out of reach. Each draw walks by 0.3 m, their mean by none."""
    off_m = []
    for seed in range(6):
        cloud, beside = Cloud(shipped_sonar()), Bystander(3, (0.0, 3.0, 0.0), 0.2, 0.0, moves=False)
        cloud._chance = np.random.default_rng(seed)
        for number in range(60):
            time_s = 5.0 + READING_S * number
            cloud.heard(time_s, 3.0, Axis(EAST, 0.0), (9.0, 0.0, 0.0), [beside])
        off_m.append((cloud.north_m, cloud.east_m))

    assert math.hypot(*np.mean(off_m, axis=0)) < 0.5


def test_a_cloud_that_turns_to_another_leader_is_as_sure_as_it_is_told() -> None:
    cloud = Cloud(shipped_sonar())
    cloud.turn_to(Off(1.0, -2.0, 0.3, 0.4, 0.2))
    assert (cloud.north_m, cloud.east_m, cloud.up_m) == pytest.approx((1.0, -2.0, 0.3), abs=0.02)
    assert cloud.sigma_m(0.0) == pytest.approx(0.4, rel=0.05)
    assert cloud.up_sigma_m == pytest.approx(0.2, rel=0.05)
    assert not cloud.has_heard


def test_that_another_leader_is_elsewhere_is_no_drift() -> None:
    """By 4 m. Taken for the same pair they would wander by 3 m, which keeps a follower far off."""
    cloud = Cloud(shipped_sonar())
    for number in range(60):
        off_m = 0.0 if number < 30 else 4.0
        if number == 30:
            cloud.turn_to(Off(3.5, 0.0, 0.0, 0.5, 0.3))
        believed = (FAR_M + off_m, 0.0, 0.0)
        cloud.heard(READING_S * number, FAR_M, Axis(NORTH, 0.0), believed)

    assert cloud.north_m == pytest.approx(4.0, abs=0.15)
    assert cloud.wander_m < 1.2
