import math
import random
from dataclasses import replace

import pytest

from echowing.flight.alignment import History, Report
from echowing.flight.axis import Axis
from echowing.flight.cloud import PLACED_SIGMA_M, UPDATE_PERIOD_S, Cloud, Off
from echowing.flight.estimate import (
    CLOCK_WINDOW_S,
    LONGEST_CARRY_S,
    SONAR_AGE_S,
    STUCK_S,
    Beside,
    Estimate,
    SenderClock,
    carried_on,
)
from echowing.flight.guidance import Horizontal, LeaderFix
from echowing.geo import GlobalPosition, displace, ned_between
from echowing.sonar_file import shipped_sonar

START = GlobalPosition(39.34, -86.03, 260.0)


def test_the_least_delayed_message_sets_a_senders_clock() -> None:
    chance, clock = random.Random(1), SenderClock()
    for number in range(150):
        stamp_s = number * 0.1
        delay_s = 0.05 + (0.0 if number == 40 else chance.uniform(0.02, 0.5))
        ours_s = clock.to_ours(stamp_s, 1000.0 + stamp_s + delay_s, 0.05)

    assert ours_s == pytest.approx(1000.0 + stamp_s, abs=1e-6)


def test_before_the_best_message_it_is_late_by_the_best_so_far() -> None:
    clock = SenderClock()

    assert clock.to_ours(0.0, 100.4, 0.1) == pytest.approx(100.3)
    assert clock.to_ours(0.1, 100.3, 0.1) == pytest.approx(100.2)
    assert clock.to_ours(0.2, 100.8, 0.1) == pytest.approx(100.3)


def test_a_clock_that_drifts_is_followed() -> None:
    """A way that has grown longer counts once the shorter one is out of the window."""
    clock = SenderClock()
    for number in range(400):
        stamp_s = number * 0.1
        delay_s = 0.1 if stamp_s < 10.0 else 0.3
        ahead_s = clock.to_ours(stamp_s, stamp_s + delay_s, 0.0) - stamp_s
        expected_s = 0.1 if stamp_s < 10.0 + CLOCK_WINDOW_S - 0.15 else 0.3
        assert ahead_s == pytest.approx(expected_s), stamp_s


def test_a_sender_that_starts_anew_begins_anew() -> None:
    clock = SenderClock()
    clock.to_ours(500.0, 1000.0, 0.0)

    assert clock.to_ours(1.0, 1010.0, 0.0) == pytest.approx(1010.0)
    assert clock.to_ours(2.0, 1011.0, 0.0) == pytest.approx(1011.0)


def test_a_message_out_of_order_is_no_new_start() -> None:
    clock = SenderClock()
    clock.to_ours(500.0, 1000.0, 0.0)

    assert clock.to_ours(499.0, 1000.5, 0.0) == pytest.approx(999.0)


def listening(
    lean_mps2: float = 0.0, above_m: float = 0.0, inset_m: float = 0.2
) -> tuple[Estimate, History]:
    """A follower 3 m south of its leader, and below it, both known from 0 to 10 s."""
    estimate, leader = Estimate(replace(shipped_sonar(), inset_m=inset_m)), History()
    for number in range(41):
        time_s = number * 0.25
        leader.add(Report(time_s, displace(START, (3.0, 0.0, -above_m)), (0.0, 0.0), 0.0))
        gained: Horizontal = (lean_mps2 * time_s, 0.0)
        estimate.reported(Report(time_s, START, gained, 0.0))
    return estimate, leader


def swaying_m(range_m: float, number: int) -> float:
    """A reading of two vehicles in the air: it is never long the same to the centimetre."""
    return range_m + 0.01 * (number // 4 % 2)


def read(estimate: Estimate, leader: History, tenth: int, range_m: float) -> None:
    """A reading after so many tenths of a second, with both vehicles' reports, 3 m apart."""
    time_s = 0.1 * tenth
    leader.add(Report(time_s, displace(START, (3.0, 0.0, 0.0)), (0.0, 0.0), 0.0))
    estimate.reported(Report(time_s, START, (0.0, 0.0), 0.0))
    estimate.heard(time_s, range_m)
    estimate.learn(leader)


@pytest.mark.parametrize("tenths", [1, 2, 3])
def test_what_a_stuck_sensor_taught_is_forgotten_and_what_was_known_before_is_not(
    tenths: int,
) -> None:
    """After 30 readings alike, however seldom they come; a formation repeats a centimetre 5 times.

    It gives one other range, and is stuck again.
    """
    estimate, leader = Estimate(shipped_sonar()), History()
    unknown_m = estimate.offset.sigma_m(0.0)
    for number in range(60):  # half a metre nearer than receivers say
        read(estimate, leader, tenths * number, swaying_m(2.3, number))
    known_m = estimate.offset.north_m
    assert known_m == pytest.approx(0.5, abs=PLACED_SIGMA_M)
    readings = round(STUCK_S * estimate.sonar.rate_hz)
    for first in (60, 60 + readings + 2):
        for number in range(first, first + readings):
            read(estimate, leader, tenths * number, 3.2)
            assert estimate.is_believed
        assert estimate.offset.north_m < 0.0
        read(estimate, leader, tenths * (first + readings), 3.2)
        assert not estimate.is_believed
        assert estimate.offset.north_m == pytest.approx(known_m, abs=2.0 * PLACED_SIGMA_M)
        assert estimate.offset.sigma_m(0.0) < 0.6 * unknown_m
        read(estimate, leader, tenths * (first + readings + 1), 7.65)
        assert estimate.is_believed


def test_what_a_wild_sensor_taught_is_forgotten_and_what_was_known_before_is_not() -> None:
    """It comes and goes: two of ten are a fault, and with one in seven it is believed again.

    The first reading that is believed again may be wrong.
    """
    estimate, leader, chance = Estimate(shipped_sonar()), History(), random.Random(3)
    faults, off_m = 0, []
    for tenth in range(600):
        wild = tenth > 60 and chance.random() < 0.25
        believed = estimate.is_believed
        read(estimate, leader, tenth, chance.uniform(0.3, 4.4) if wild else swaying_m(2.3, tenth))
        faults += believed and not estimate.is_believed
        off_m.append(abs(estimate.offset.north_m - 0.5))
    assert faults > 2
    assert sum(one > 2.0 * PLACED_SIGMA_M for one in off_m[30:]) < 0.05 * len(off_m)


def test_what_a_sonar_says_that_is_not_believed_is_still_counted() -> None:
    estimate, leader = Estimate(shipped_sonar()), History()
    for tenth in range(120):
        read(estimate, leader, tenth, swaying_m(2.3, tenth) if tenth < 60 else 3.2)
    assert len(estimate.hearing.fresh) > 110 - 10 * 3


def test_a_sensor_that_is_stuck_from_the_start_teaches_nothing() -> None:
    estimate, leader = Estimate(shipped_sonar()), History()
    unknown_m = estimate.offset.sigma_m(0.0)
    for tenth in range(round(STUCK_S * estimate.sonar.rate_hz) + 1):
        read(estimate, leader, tenth, 2.5)
    assert not estimate.is_believed
    assert estimate.offset.unheard_s(5.0) == math.inf
    assert estimate.offset.sigma_m(0.0) == pytest.approx(unknown_m, rel=0.05)


def test_a_sonar_that_hears_anything_teaches_nothing_and_is_believed_once_it_agrees() -> None:
    """Of its readings one in ten is by chance like the one before: it moved the leader by 5 m."""
    estimate, leader = listening()
    unknown_m = estimate.offset.sigma_m(0.0)
    chance = random.Random(7)
    for number in range(40):
        estimate.heard(2.0 + number * 0.1, chance.uniform(0.2, 7.65))
        estimate.learn(leader)
    assert estimate.is_wild
    assert not estimate.listens(6.0)
    assert (estimate.offset.north_m, estimate.offset.east_m) == pytest.approx((0.0, 0.0), abs=0.05)
    assert estimate.offset.sigma_m(0.0) == pytest.approx(unknown_m, rel=0.05)

    for number in range(30):
        estimate.heard(6.0 + number * 0.1, swaying_m(2.8, number))
    assert not estimate.is_wild
    estimate.learn(leader)
    assert estimate.offset.unheard_s(9.0) < UPDATE_PERIOD_S + SONAR_AGE_S


@pytest.mark.parametrize("wild_share", [0.01, 0.03])
def test_a_healthy_sonar_is_believed_through_its_wild_readings(wild_share: float) -> None:
    """Twenty minutes at the edge of the beam: 1.5 m/s, misses, wild ones."""
    estimate = Estimate(shipped_sonar())
    chance = random.Random(11)
    for number in range(12_000):
        range_m = 2.5 + 0.75 * math.sin(2.0 * number * 0.1)
        if chance.random() < 0.3:
            range_m = 7.65
        if chance.random() < wild_share:
            range_m = chance.uniform(0.2, 7.65)
        estimate.heard(number * 0.1, range_m + chance.gauss(0.0, 0.01))
        assert not estimate.is_wild


def test_nothing_in_reach_is_the_same_for_as_long_as_it_likes() -> None:
    estimate, leader = listening()
    hear_nothing(estimate, leader)
    known_m = estimate.offset.sigma_m(0.0)
    for number in range(10):
        estimate.heard(8.1 + number * 0.1, 7.65)
    estimate.learn(leader)
    assert estimate.offset.sigma_m(0.0) != known_m


def test_a_reading_that_fits_is_the_leader() -> None:
    """It waits for no other: where the leader is rarely heard, none may come."""
    estimate, leader = listening()
    unknown_m = estimate.offset.sigma_m(0.0)

    estimate.heard(9.1, 2.8)
    estimate.learn(leader)
    assert estimate.offset.unheard_s(10.0) == pytest.approx(0.9 + SONAR_AGE_S)
    assert estimate.offset.sigma_m(0.0) < 0.6 * unknown_m


def test_a_leader_is_missed_by_the_readings_that_were_used_and_not_by_now() -> None:
    """Readings to 9.1 s, and both vehicles known to 10 s; what comes later has not been used."""
    estimate, leader = listening()
    assert estimate.missed_s == math.inf
    estimate.learn(leader)
    assert estimate.missed_s == math.inf  # never heard

    estimate.heard(9.1, 2.8)
    estimate.learn(leader)
    assert estimate.missed_s == pytest.approx(0.9 + SONAR_AGE_S)

    # The follower reports again, by a slow radio, and the leader's next report is on its way.
    estimate.reported(Report(11.5, START, (0.0, 0.0), 0.0))
    assert estimate.missed_s == pytest.approx(0.9 + SONAR_AGE_S)
    leader.add(Report(12.0, displace(START, (3.0, 0.0, 0.0)), (0.0, 0.0), 0.0))
    estimate.learn(leader)
    assert estimate.missed_s == pytest.approx(2.4 + SONAR_AGE_S)


def test_a_wild_reading_does_not_outlast_the_leaders_own() -> None:
    """Of a leader that was not heard before: it may be wrong, and that stays open."""
    estimate, leader = listening()
    for time_s, range_m in ((8.0, 1.1), (8.3, 2.8), (8.6, 2.82), (8.9, 2.79)):
        estimate.heard(time_s, range_m)
    estimate.learn(leader)

    assert estimate.offset.north_m == pytest.approx(0.0, abs=2.0 * PLACED_SIGMA_M)


def test_a_wild_reading_moves_no_leader_that_is_heard() -> None:
    estimate, leader = Estimate(shipped_sonar()), History()
    for tenth in range(60):
        read(estimate, leader, tenth, swaying_m(2.8, tenth))
    before_m = estimate.offset.north_m
    read(estimate, leader, 63, 1.1)
    read(estimate, leader, 66, 2.8)

    assert estimate.offset.north_m == pytest.approx(before_m, abs=PLACED_SIGMA_M / 3.0)


def test_no_range_is_no_reading() -> None:
    """A co-processor without a sonar reports a range of zero or less."""
    estimate, leader = listening()
    estimate.heard(9.0, -1.0)
    estimate.heard(9.1, 0.0)
    estimate.learn(leader)

    assert estimate.offset.unheard_s(10.0) == math.inf


@pytest.mark.parametrize(
    ("beside", "reports", "seems_up_m"),
    [(True, 41, 0.0), (True, 33, 0.0), (True, 41, 4.0), (False, 41, 0.0)],
)
def test_a_range_that_another_vehicle_explains_better_is_not_the_leaders(
    beside: bool, reports: int, seems_up_m: float
) -> None:
    """The leader is 3 m north, another follower 3 m east, and the sonar looks east.

    The other one's reports may come later than those of the two: over a slow radio. And they may be
    too high by what the sonars between have found.
    """
    estimate, leader = listening()
    estimate.offset = Cloud(shipped_sonar())
    other = History()
    for number in range(reports):
        place = displace(START, (0.0, 3.0, -seems_up_m))
        other.add(Report(number * 0.25, place, (0.0, 0.0), 0.0))
    others = [Beside(3, other, Off(0.0, 0.0, -seems_up_m, 0.1, 0.1))] if beside else []
    for number in range(80):
        estimate.heard(1.0 + number * 0.1, swaying_m(2.8, number), number)
        estimate.pointed(number, Axis(math.pi / 2.0, 0.0), 1.0 + number * 0.1)
    estimate.learn(leader, others)

    moved_m = math.hypot(estimate.offset.north_m, estimate.offset.east_m)
    assert (moved_m < 1.0) is beside


def test_one_whose_report_is_old_may_be_elsewhere_by_what_it_has_changed_its_speed_by() -> None:
    estimate, _ = listening()
    other = History()
    other.add(Report(7.0, displace(START, (0.0, 3.0, 0.0)), (0.0, 1.0), 0.0))
    (one,) = estimate._bystanders([Beside(3, other, Off(0.0, 0.0, 0.0, 0.1, 0.0))], 8.0)
    assert one.to_it_m == pytest.approx((0.0, 4.0, 0.0), abs=0.01)
    # ArduCopter's 2.5 m/s2 for a second are 2.5 standard deviations.
    assert one.sigma_m == pytest.approx(math.hypot(0.1, 0.5))
    assert estimate._bystanders([Beside(3, other, Off(0.0, 0.0, 0.0, 0.1, 0.0))], 10.5) == []


@pytest.mark.parametrize(
    ("to_other_m", "moves", "elsewhere_m"),
    [
        # If the echo 3 m north is that of one that seems to be 3 m east of it, the leader is 3 m
        # west of there.
        ((3.0, 3.0), True, [(0.0, -3.0)]),
        ((3.0, 3.0), False, []),  # it is known from here, not from the leader
        ((3.0, 0.5), True, []),  # the beam has both
        ((6.1, 0.0), True, []),  # the leader would be here
        ((-1.0, 3.0), True, []),  # the leader would be out of reach, 7 m north
    ],
)
def test_who_is_looked_for_may_be_elsewhere_if_the_echo_is_anothers(
    to_other_m: Horizontal, moves: bool, elsewhere_m: list[Horizontal]
) -> None:
    estimate, leader = listening()
    other = History()
    for number in range(41):
        place = displace(START, (*to_other_m, 0.0))
        other.add(Report(number * 0.25, place, (0.0, 0.0), 0.0))
    estimate.heard(9.0, 2.8, 1)
    estimate.pointed(1, Axis(0.0, 0.0), 9.0)
    estimate.learn(leader, [Beside(3, other, Off(0.0, 0.0, 0.0, 0.1, 0.1), moves)])

    found = [one[:2] for one in estimate.elsewhere_m]
    assert len(found) == len(elsewhere_m)
    for one, wanted in zip(found, elsewhere_m, strict=True):
        assert one == pytest.approx(wanted, abs=0.05)


def test_what_receivers_have_lately_drifted_by_counts_at_once() -> None:
    """The leader's by a metre, the follower's by half of it: no sonar has heard since."""
    estimate, leader = listening()
    estimate.learn(leader)
    before_m = estimate.shift_m
    drifted = displace(START, (4.0, 0.0, 0.0))
    leader.add(Report(10.25, drifted, (0.0, 0.0), 0.0, drifted_m=(1.0, 0.0)))
    own = displace(START, (0.5, 0.0, 0.0))
    estimate.reported(Report(10.25, own, (0.0, 0.0), 0.0, drifted_m=(0.5, 0.0)))

    north_m, east_m = estimate.shift_m
    assert (north_m - before_m[0], east_m - before_m[1]) == pytest.approx((0.5, 0.0))
    seen_m = ned_between(own, estimate.as_seen(drifted))
    assert seen_m[0] == pytest.approx(3.0 - before_m[0], abs=0.01), "as far apart as before"


def hear_nothing(estimate: Estimate, leader: History) -> None:
    for number in range(60):
        estimate.heard(2.0 + number * 0.1, 7.65)
    estimate.learn(leader)


@pytest.mark.parametrize(
    ("so", "within_m"),
    [
        ({"lean_mps2": 2.5}, 0.0),  # it leans by 14 degrees, though the leader is straight ahead
        # 3 m away the beam reaches 1 m up; 4,000 guesses tell 1.4 m to 2 cm.
        ({"above_m": 3.0}, 0.04),
    ],
    ids=["leaning", "below"],
)
def test_silence_of_a_level_follower_counts_and_of_one_that_looks_past_its_leader_not(
    so: dict[str, float], within_m: float
) -> None:
    level, leader = listening()
    looks_past, beside = listening(**so)
    known_m = level.offset.sigma_m(math.pi / 2)

    hear_nothing(level, leader)
    hear_nothing(looks_past, beside)

    assert level.offset.sigma_m(math.pi / 2) > known_m + 0.05
    assert abs(looks_past.offset.sigma_m(math.pi / 2) - known_m) <= within_m


def test_the_inset_is_added_to_the_range() -> None:
    """Receivers say 3.0 m; the sonar's 2.6 m from face to legs are 2.8 m: 0.2 m between them."""
    with_inset, leader = listening()
    without, _ = listening(inset_m=0.0)
    for number in range(80):
        with_inset.heard(1.0 + number * 0.1, swaying_m(2.8, number))
        without.heard(1.0 + number * 0.1, swaying_m(2.8, number))
    with_inset.learn(leader)
    without.learn(leader)

    assert without.offset.north_m - with_inset.offset.north_m == pytest.approx(0.2, abs=0.05)


def test_a_leader_is_moved_by_what_was_learnt_and_back_when_it_is_forgotten() -> None:
    estimate, leader = listening()
    for number in range(80):
        # 0.8 m nearer than receivers say
        estimate.heard(1.0 + number * 0.1, swaying_m(2.0, number))
    estimate.learn(leader)
    believed = displace(START, (3.0, 0.0, 0.0))

    north_m, _, _ = ned_between(START, estimate.as_seen(believed))
    assert north_m == pytest.approx(2.2, abs=0.25)

    estimate.forget()
    assert ned_between(START, estimate.as_seen(believed)) == pytest.approx(
        (3.0, 0.0, 0.0), abs=0.01
    )


def test_a_report_is_carried_on_so_far_and_no_further() -> None:
    fix = LeaderFix(10.0, START, (2.0, 0.0, 0.0), 0.0)

    for to_s, north_m in ((10.5, 1.0), (9.0, 0.0), (60.0, 2.0 * LONGEST_CARRY_S)):
        assert ned_between(START, carried_on(fix, to_s).position)[0] == pytest.approx(
            north_m, abs=1e-3
        )
