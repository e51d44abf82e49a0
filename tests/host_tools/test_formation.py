import math

import pytest

from echowing.errors import EchowingError
from echowing.flight.formation import check_formation, slot_distance_m, turning_together
from echowing.flight.guidance import GRAY, GuidanceSettings, Slot


def test_slots_apart_are_accepted() -> None:
    check_formation([Slot(3.0), Slot(6.0), Slot(6.0, math.radians(60.0))])


def test_two_slots_too_near_are_named_with_their_distance() -> None:
    with pytest.raises(EchowingError, match=r"slots 2 and 3 are 1\.00 m apart, less than 2\.00 m"):
        check_formation([Slot(3.0), Slot(6.0), Slot(7.0)])


def test_altitude_steps_count() -> None:
    assert slot_distance_m(Slot(3.0), Slot(3.0, 0.0, 2.5)) == pytest.approx(2.5)
    check_formation([Slot(3.0), Slot(3.0, 0.0, 2.5)])


@pytest.mark.parametrize("radius_m", [0.9, 0.0, -3.0, math.nan])
def test_a_slot_inside_the_leaders_clearance_is_refused(radius_m: float) -> None:
    with pytest.raises(EchowingError, match="slot 1 has a radius"):
        check_formation([Slot(radius_m)])


@pytest.mark.parametrize("angle_deg", [91.0, -180.0])
def test_a_slot_ahead_of_the_leader_is_refused(angle_deg: float) -> None:
    with pytest.raises(EchowingError, match="ahead of the leader"):
        check_formation([Slot(3.0, math.radians(angle_deg))])


def test_an_empty_formation_is_refused() -> None:
    with pytest.raises(EchowingError, match="no slots"):
        check_formation([])


def test_a_wide_formation_turns_as_slowly_as_its_outermost_follower_can() -> None:
    alone = turning_together([Slot(3.0)], GuidanceSettings())
    wide = turning_together([Slot(3.0), Slot(32.0)], GuidanceSettings())

    assert alone.slot_rate_rps == pytest.approx(math.radians(30.0))
    # 1.6 m/s at 32 m.
    assert wide.slot_rate_rps == pytest.approx(0.05)
    assert turning_together([Slot(32.0)], GRAY).slot_rate_rps is None
