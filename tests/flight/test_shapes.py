"""Formations by name: where everybody is, and at whom each sonar looks."""

import math
from itertools import combinations, pairwise

import pytest

from echowing.errors import EchowingError
from echowing.flight.formation import check_formation, hung_on_leader
from echowing.flight.guidance import Slot, place_m
from echowing.flight.shapes import MOST_FOLLOWERS, SHAPES, shape
from echowing.sonar_file import shipped_sonar

SPACING_M = 3.0
NUMBERS = range(1, MOST_FOLLOWERS + 1)


def places(slots: list[Slot] | tuple[Slot, ...]) -> list[tuple[float, float]]:
    """(back, right) from the leader, metres, of each slot."""
    return [(-place_m(slots, n)[0], place_m(slots, n)[1]) for n in range(len(slots))]


@pytest.mark.parametrize("followers", NUMBERS)
@pytest.mark.parametrize("name", SHAPES)
def test_nobody_is_nearer_than_the_spacing_and_each_watches_a_neighbour(
    name: str, followers: int
) -> None:
    slots = shape(name, followers, SPACING_M)
    everybody = [(0.0, 0.0), *places(slots)]
    assert len(slots) == followers
    apart_m = [math.dist(a, b) for a, b in combinations(everybody, 2)]
    assert min(apart_m) == pytest.approx(SPACING_M)
    for number, slot in enumerate(slots, 1):
        watched = 0 if slot.behind is None else slot.behind + 1
        assert watched < number
        assert math.dist(everybody[number], everybody[watched]) == pytest.approx(SPACING_M)
        assert everybody[number][0] >= everybody[watched][0] - 1e-9, "nobody looks back"


@pytest.mark.parametrize("followers", NUMBERS)
@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_passes_the_checks_within_the_sonars_reach(name: str, followers: int) -> None:
    """A diamond is held together by chains of up to seven sonars, and so is wider."""
    spacing_m = 4.5 if name == "diamond" else SPACING_M
    check_formation(shape(name, followers, spacing_m), shipped_sonar(), 1.0)


def test_a_column_is_one_line_astern() -> None:
    for number, place in enumerate(places(shape("column", 3, 3.0)), 1):
        assert place == pytest.approx((3.0 * number, 0.0), abs=1e-9)


@pytest.mark.parametrize(("name", "off_deg"), [("echelon", 35.0), ("abreast", 90.0)])
def test_an_echelon_and_a_line_abreast_are_one_arm_to_the_right(name: str, off_deg: float) -> None:
    back, right = math.cos(math.radians(off_deg)), math.sin(math.radians(off_deg))
    wanted = [(n * back, n * right) for n in (2.0, 4.0, 6.0)]
    for place, there in zip(places(shape(name, 3, 2.0)), wanted, strict=True):
        assert place == pytest.approx(there, abs=1e-9)
    assert [slot.behind for slot in shape(name, 3, 2.0)] == [None, 0, 1]


def test_a_vee_has_two_arms_that_hang_on_the_leader() -> None:
    slots = shape("vee", 5, 3.0)
    assert [slot.behind for slot in slots] == [None, None, 0, 1, 2]
    right, left = places(slots)[0::2], places(slots)[1::2]
    assert [math.degrees(math.atan2(y, x)) for x, y in right] == pytest.approx([35.0] * 3)
    assert [math.degrees(math.atan2(y, x)) for x, y in left] == pytest.approx([-35.0] * 2)
    assert [math.dist(a, b) for a, b in pairwise(right)] == pytest.approx([3.0, 3.0])


def test_a_diamond_of_three_has_its_last_at_the_tail_point() -> None:
    slots = shape("diamond", 3, 3.0)
    aside_m = 3.0 / math.sqrt(2.0)
    wanted = [(aside_m, aside_m), (aside_m, -aside_m), (2.0 * aside_m, 0.0)]
    for place, there in zip(places(slots), wanted, strict=True):
        assert place == pytest.approx(there, abs=1e-9)
    assert slots[2].behind in (0, 1)


def test_a_diamond_of_eight_is_the_next_square_on_its_corner() -> None:
    rows = [round(back_m / 3.0 * math.sqrt(2.0)) for back_m, _ in places(shape("diamond", 8, 3.0))]
    assert sorted(rows) == [1, 1, 2, 2, 2, 3, 3, 4]


def test_hung_on_the_leader_everybody_stays_where_he_is() -> None:
    slots = shape("vee", 4, 5.0)
    hung = hung_on_leader(slots)
    assert {slot.behind for slot in hung} == {None}
    for place, there in zip(places(hung), places(slots), strict=True):
        assert place == pytest.approx(there)


@pytest.mark.parametrize(
    ("name", "followers", "spacing_m", "says"),
    [
        ("wedgie", 3, 3.0, "no shape 'wedgie': give column, vee, echelon, abreast, diamond"),
        ("eschelon", 3, 3.0, "the nearest is echelon"),
        ("vee", 0, 3.0, "vee: 0 followers: give 1 to 12"),
        ("vee", 13, 3.0, "vee: 13 followers: give 1 to 12"),
        ("vee", 3, 0.9, r"vee: a spacing of 0\.9 m: give 1 m or more"),
        ("vee", 3, math.nan, "vee: a spacing of nan m"),
        ("vee", 3, math.inf, "vee: a spacing of inf m"),
    ],
)
def test_what_is_no_shape_is_refused(
    name: str, followers: int, spacing_m: float, says: str
) -> None:
    with pytest.raises(EchowingError, match=says):
        shape(name, followers, spacing_m)
