"""What a sonar hears in flight, beside what is believed of it."""

import math
import random
from dataclasses import replace
from itertools import pairwise

import pytest

from echowing.flight.belief import Curve, SonarBelief
from echowing.flight.clocks import LOST_S
from echowing.flight.hearing import LEAST_READINGS, WINDOW_S, Heard, Hearing, Reading, scatter_m
from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario
from echowing.sonar_file import shipped_sonar

from ..world import CLEARLY

pytestmark = pytest.mark.seconds(13)

# Half of the pings, two in a hundred wrong, 3 cm.
BELIEF = replace(
    shipped_sonar(), heard=Curve((0.2, 4.0), (0.5, 0.5)), wrong_share=0.02, noise_m=0.03
)
PERIOD_S = 0.1


def heard(
    share: float,
    *,
    noise_m: float = 0.02,
    wrong_share: float = 0.0,
    off_deg: float = 0.0,
    sure_deg: float = 2.0,
    expected_m: float = 2.8,
    seconds: float = 60.0,
    sonar: SonarBelief = BELIEF,
) -> Heard:
    """What is told after so long of a sonar that hears so."""
    chance, hearing = random.Random(4), Hearing(sonar)
    for number in range(round(seconds / PERIOD_S)):
        t_s = number * PERIOD_S
        # It sways with its vehicle: half a metre to and fro in six seconds.
        away_m = expected_m + 0.25 * math.sin(t_s)
        range_m: float | None = None
        if chance.random() < wrong_share:
            range_m = chance.uniform(4.0, 4.5)
        elif chance.random() < share:
            range_m = math.floor(100.0 * (away_m + chance.gauss(0.0, noise_m))) / 100.0
        hearing.take(Reading(t_s, range_m, away_m, math.radians(off_deg), math.radians(sure_deg)))
    return hearing.heard()


@pytest.mark.parametrize("share", [0.35, 0.7, 1.0])
def test_the_share_is_what_it_hears_within_its_beam(share: float) -> None:
    found = heard(share)

    # Of 600 readings; standard deviation 0.02.
    assert found.share == pytest.approx(share, abs=0.07)


def test_a_leader_beside_the_beam_tells_nothing_of_the_share() -> None:
    assert heard(0.1, off_deg=25.0).share is None
    assert heard(0.1, expected_m=3.8).share is None  # out of reach, perhaps


def test_readings_tell_of_the_share_as_far_as_a_slot_opens_for_it() -> None:
    """Or it would never be seen to hear again. It sways by 0.25 m: half of them count."""
    reads_m = Hearing(BELIEF).counts_to_m - BELIEF.inset_m
    assert heard(0.8, expected_m=reads_m).share == pytest.approx(0.8, abs=0.07)


def test_nothing_is_told_of_a_few_readings() -> None:
    few = heard(0.7, seconds=0.9 * LEAST_READINGS * PERIOD_S)

    assert (few.share, few.wrong_share, few.worse) == (None, None, None)


def test_a_leader_that_is_lost_is_not_the_sonars_fault() -> None:
    """Nobody knows where it is then: only what came soon after a right reading counts."""
    hearing = Hearing(BELIEF)
    for number in range(600):
        t_s = number * PERIOD_S
        hearing.take(Reading(t_s, 2.8 if t_s < 20.0 else None, 2.8, 0.0, 0.03))

    seconds = 20.0 + LOST_S
    assert hearing.heard().share == pytest.approx(20.0 / seconds, abs=0.03)


@pytest.mark.parametrize("noise_m", [0.02, 0.06])
def test_the_scatter_is_that_of_the_ranges_and_not_of_the_vehicles(noise_m: float) -> None:
    assert heard(0.9, noise_m=noise_m).scatter_m == pytest.approx(noise_m, rel=0.25)


def test_ranges_that_do_not_come_in_a_row_tell_no_scatter() -> None:
    apart = [Reading(0.5 * n, 2.8 + 0.1 * (n % 2), 2.8, 0.0, 0.03) for n in range(100)]

    assert scatter_m(apart) is None
    assert all(b.time_s - a.time_s == 0.5 for a, b in pairwise(apart))


def test_readings_of_something_else_are_counted() -> None:
    assert heard(0.9, wrong_share=0.1).wrong_share == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize(
    ("found", "says"),
    [
        (heard(0.25), "sonar hears 2"),
        (heard(0.9, wrong_share=0.15), "of ranges wrong, 2% is believed"),
        (heard(0.9, noise_m=0.08), "cm, 3 cm is believed"),
    ],
)
def test_what_is_worse_than_believed_is_told(found: Heard, says: str) -> None:
    assert says in str(found.worse)
    # As a text on a pilot's screen, after "Echowing: 2 ".
    assert len(str(found.worse)) <= 38
    assert BELIEF.objection(3.0) is None
    assert found.sonar is not None
    assert found.sonar.objection(3.0) is not None, "by such a sonar nobody flies 3 m behind"


@pytest.mark.parametrize("share", [0.5, 0.6, 1.0])
def test_one_as_believed_or_better_is_not_told_of(share: float) -> None:
    found = heard(share, wrong_share=0.02, noise_m=0.03)
    assert (found.worse, found.sonar) == (None, None)
    assert found.of_believed == pytest.approx(share / 0.5, rel=0.1)


def test_bursts_are_allowed_for() -> None:
    """Four readings in a row are alike: half of them by chance is not worse than half."""
    hearing, chance = Hearing(BELIEF), random.Random(8)
    worse = 0
    for number in range(6000):
        if number % 4 == 0:
            hears = chance.random() < 0.5
        hearing.take(Reading(number * PERIOD_S, 2.8 if hears else None, 2.8, 0.0, 0.03))
        worse += hearing.heard().worse is not None
    # 5 % by chance, and the minutes hang together.
    assert worse / 6000 < 0.15


# ---- in a whole flight ---------------------------------------------------------------------------


def flown(*changes: str) -> tuple[Heard, list[str]]:
    flight = FormationFlight(load_scenario("echowing", [*CLEARLY, "duration_s=70", *changes]), 2)
    events = [text for _, text in flight.run().events]
    return flight.ground.session.followers[2].estimate.hearing.heard(), events


def test_a_flight_with_a_bad_sonar_says_so_and_one_with_a_good_one_does_not() -> None:
    good, said = flown()
    noisy, of_noise = flown("sonar.noise_m=0.08", "duration_s=30")  # it is said once engaged

    assert good.share is not None and good.share > 0.75
    assert good.scatter_m is not None and good.scatter_m < 0.03
    assert good.worse is None
    assert not any("believed" in text for text in said)
    assert noisy.scatter_m is not None and noisy.scatter_m > 0.06
    assert any("ranges scatter" in text and "3 cm is believed" in text for text in of_noise)
    assert any("sonar not good enough, slot 3" in text for text in of_noise)


def test_who_hears_too_little_keeps_further_off() -> None:
    """With receivers that hardly wander: else they would move the follower by as much."""
    hardly = ("gps.sigma_m=0.1", "gps.spread=0")
    scenario = load_scenario("echowing", ["sonar.heard_share=0.1", "duration_s=120", *hardly])
    flight = FormationFlight(scenario, 1)
    result = flight.run()
    (opens_s,) = [at_s for at_s, text in result.events if "sonar not good enough" in text]
    (flown,) = result.flights
    before = (flown.time_s > 15.0) & (flown.time_s < opens_s)
    after = flown.time_s > opens_s + 15.0
    assert flown.separation_m[before].mean() < 3.4
    assert flown.separation_m[after].mean() > 3.4
    assert flown.separation_m[after].min() > 1.0


def test_who_hears_again_comes_back() -> None:
    scenario = load_scenario("echowing", ["sonar.heard_share=0.1", "duration_s=300"])
    flight = FormationFlight(scenario, 1)
    (follower,) = flight.ground.session.followers.values()
    while follower.heard_as is None:
        flight.step()
    ear = flight.followers[0].ear
    ear.sonar = replace(ear.sonar, heard=Curve((0.0,), (0.95,)))
    hears_s = flight.t_s
    while follower.heard_as is not None:
        flight.step()
    assert flight.t_s - hears_s < 2.0 * WINDOW_S
