import math
import random

import pytest

from echowing.offset import GATE_SIGMAS, RelativeOffset, Wandering

PRIOR_M = 0.8 * math.sqrt(2.0)
NORTH, EAST = 0.0, math.pi / 2


def listen(
    offset: RelativeOffset, true: tuple[float, float], axis_rad: float, start_s: float, count: int
) -> None:
    """`count` readings, one every half second, of a leader 3 m along the axis."""
    rel = (3.0 * math.cos(axis_rad), 3.0 * math.sin(axis_rad))
    believed = (rel[0] + true[0], rel[1] + true[1])
    for number in range(count):
        offset.heard(start_s + number * 0.5, 3.0, axis_rad, believed)


def test_at_first_nothing_is_known_but_how_far_receivers_wander() -> None:
    offset = RelativeOffset()

    assert (offset.north_m, offset.east_m) == (0.0, 0.0)
    assert offset.sigma_m(NORTH) == pytest.approx(PRIOR_M)
    assert offset.sigma_m(1.0) == pytest.approx(PRIOR_M)


def test_along_the_beam_it_learns_much_and_across_it_little() -> None:
    offset = RelativeOffset()

    listen(offset, (1.0, 0.0), NORTH, 0.0, 12)

    assert offset.north_m == pytest.approx(1.0, abs=0.15)
    assert offset.sigma_m(NORTH) < 0.3
    assert offset.sigma_m(EAST) > 2.0 * offset.sigma_m(NORTH)


@pytest.mark.parametrize("bearing_deg", range(0, 360, 30))
def test_bearings_are_all_alike(bearing_deg: int) -> None:
    axis = math.radians(bearing_deg)
    offset = RelativeOffset()

    listen(offset, (0.8 * math.cos(axis), 0.8 * math.sin(axis)), axis, 0.0, 12)

    along = offset.north_m * math.cos(axis) + offset.east_m * math.sin(axis)
    across = offset.east_m * math.cos(axis) - offset.north_m * math.sin(axis)
    assert along == pytest.approx(0.8, abs=0.12)
    assert across == pytest.approx(0.0, abs=0.01)


def test_two_legs_of_a_rectangle_show_both_axes() -> None:
    offset = RelativeOffset()

    listen(offset, (0.7, -0.9), NORTH, 0.0, 20)
    listen(offset, (0.7, -0.9), EAST, 10.0, 20)

    assert offset.north_m == pytest.approx(0.7, abs=0.2)
    assert offset.east_m == pytest.approx(-0.9, abs=0.2)


def test_unheard_it_fades_and_its_uncertainty_grows_back() -> None:
    offset = RelativeOffset()
    listen(offset, (1.0, 0.0), NORTH, 0.0, 12)
    learnt, sure = offset.north_m, offset.sigma_m(NORTH)

    offset.advance(66.0)
    after_a_minute = offset.north_m
    offset.advance(600.0)

    assert after_a_minute == pytest.approx(learnt * math.exp(-60.5 / 60.0), rel=0.02)
    assert sure < offset.sigma_m(NORTH) <= PRIOR_M
    assert offset.sigma_m(NORTH) == pytest.approx(PRIOR_M, abs=0.01)


def test_wild_readings_are_left_out() -> None:
    offset = RelativeOffset()
    listen(offset, (0.0, 0.0), NORTH, 0.0, 12)

    taken = offset.heard(6.5, 0.3, NORTH, (3.0, 0.0))

    assert not taken
    assert offset.north_m == pytest.approx(0.0, abs=0.05)


def test_readings_come_too_fast_to_be_independent() -> None:
    offset = RelativeOffset()

    taken = [offset.heard(number * 0.05, 3.0, NORTH, (3.5, 0.0)) for number in range(20)]

    assert sum(taken) == 2


def test_its_uncertainty_is_honest() -> None:
    """Truth drawn as the filter believes it: errors stay within three sigmas, and fill one."""
    rng = random.Random(11)
    shares = []
    for _ in range(200):
        true = (rng.gauss(0.0, PRIOR_M), rng.gauss(0.0, PRIOR_M))
        if math.hypot(*true) > GATE_SIGMAS:
            continue
        offset = RelativeOffset(Wandering(0.8, 1e9))
        for number in range(10):
            axis = rng.uniform(-math.pi, math.pi)
            off_axis = axis + rng.gauss(0.0, 0.2)
            rel = (3.0 * math.cos(off_axis), 3.0 * math.sin(off_axis))
            offset.heard(number * 1.0, 3.0, axis, (rel[0] + true[0], rel[1] + true[1]))
        shares.append(abs(offset.north_m - true[0]) / offset.sigma_m(NORTH))
    assert max(shares) < 4.0
    assert sum(share < 1.0 for share in shares) / len(shares) > 0.68
