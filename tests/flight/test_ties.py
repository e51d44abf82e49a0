"""What receivers disagree by, any two of them, from what sonars tell of some pairs."""

import math

import numpy as np
import pytest

from echowing.flight.ties import Link, errors

LEADER, FIRST, SECOND, THIRD = ALL = [1, 2, 3, 4]
SIGMA_M = 0.8
UNRANGED_M = math.sqrt(2.0) * SIGMA_M


def test_without_any_sonar_no_two_disagree_and_that_is_as_unsure_as_receivers_are() -> None:
    links = [Link(FIRST, LEADER, 0.4, 0.1, UNRANGED_M), Link(SECOND, FIRST, 5.0, 5.0, 1.5)]
    found = errors(ALL, links, SIGMA_M)
    assert found.between(FIRST, SECOND) == pytest.approx((0.0, 0.0, UNRANGED_M))


def test_a_pair_that_a_sonar_ties_disagrees_by_what_it_tells() -> None:
    found = errors(ALL, [Link(FIRST, LEADER, 3.0, -1.0, 0.2)], SIGMA_M)
    assert found.between(LEADER, FIRST) == pytest.approx((3.0, -1.0, 0.2))
    assert found.between(FIRST, LEADER) == pytest.approx((-3.0, 1.0, 0.2))


def test_of_two_that_disagree_each_disagrees_by_half_of_it_with_a_third() -> None:
    """Known for certain: one is off by half of it, plus or minus 0.8 m / sqrt(2)."""
    found = errors(ALL, [Link(FIRST, LEADER, 3.0, -1.0, 1e-3)], SIGMA_M)
    sigma_m = SIGMA_M * math.sqrt(1.5)
    assert found.between(FIRST, SECOND) == pytest.approx((-1.5, 0.5, sigma_m), abs=1e-3)
    assert found.between(LEADER, SECOND) == pytest.approx((1.5, -0.5, sigma_m), abs=1e-3)


def test_who_disagrees_with_all_others_is_the_one_that_is_off() -> None:
    links = [Link(FIRST, LEADER, 0.0, 0.0, 1e-3), Link(SECOND, FIRST, 3.0, 0.0, 1e-3)]
    found = errors(ALL, links, SIGMA_M)
    assert found.between(SECOND, THIRD)[0] == pytest.approx(-2.0, abs=0.01)
    assert found.between(FIRST, THIRD)[0] == pytest.approx(1.0, abs=0.01)


def test_it_is_off_by_as_much_as_it_says() -> None:
    """Four receivers, three of them tied by links that are off by 0.3 m, drawn 5,000 times."""
    chance = np.random.default_rng(1)
    # What a sonar's belief says: the reading, and beforehand that two receivers are like.
    share = UNRANGED_M**2 / (UNRANGED_M**2 + 0.3**2)
    sigma_m = math.sqrt(share) * 0.3
    pairs = [(LEADER, FIRST), (LEADER, SECOND), (SECOND, THIRD), (FIRST, THIRD)]
    off: dict[tuple[int, int], list[float]] = {pair: [] for pair in pairs}
    for _ in range(5_000):
        true_m = dict(zip(ALL, SIGMA_M * chance.standard_normal(4), strict=True))
        links = []
        for follower, watched in ((FIRST, LEADER), (SECOND, FIRST)):
            heard_m = true_m[watched] - true_m[follower] + 0.3 * chance.standard_normal()
            links.append(Link(follower, watched, share * heard_m, 0.0, sigma_m))
        found = errors(ALL, links, SIGMA_M)
        for a, b in pairs:
            off[a, b].append(found.between(a, b)[0] - (true_m[a] - true_m[b]))
    for (a, b), of_pair in off.items():
        assert np.std(of_pair) == pytest.approx(found.between(a, b)[2], rel=0.04)
