import math
import subprocess
import sys
from pathlib import Path

import pytest

from echowing.commands.follow import options_of
from echowing.errors import EchowingError
from echowing.flight.envelope import SURE_SIGMAS, Other, certain_distance_m
from echowing.flight.formation import (
    IN_SLOT_M,
    check_formation,
    place_m,
    receivers_demand_m,
)
from echowing.flight.guidance import Slot
from echowing.flight.state import UNRANGED_SIGMA_M
from echowing.sim.scenario import load_scenario
from echowing.tool.formation_file import load_formation

APART_M = 2.0


def test_slots_apart_are_accepted() -> None:
    check_formation([Slot(3.0), Slot(6.0), Slot(6.0, math.radians(60.0))], APART_M)


def test_two_slots_too_near_are_named_with_their_distance() -> None:
    with pytest.raises(EchowingError, match=r"slots 2 and 3 are 1\.00 m apart, less than 2\.00 m"):
        check_formation([Slot(3.0), Slot(6.0), Slot(7.0)], APART_M)


def test_a_simulated_formation_keeps_what_follow_demands() -> None:
    """The same file, the same demand: what is rehearsed is what is flown."""
    astern = "formation.slots=[{radius_m=4.0}, {radius_m=8.0}]"
    with pytest.raises(EchowingError, match=r"4\.00 m apart, less than 4\.83 m"):
        load_scenario("echowing", [astern])
    assert load_scenario("echowing", [astern, "formation.slot_separation_m=4"])


def test_altitude_steps_count() -> None:
    slots = [Slot(3.0), Slot(3.0, 0.0, 2.5)]
    assert math.dist(place_m(slots, 0), place_m(slots, 1)) == pytest.approx(2.5)
    check_formation([Slot(3.0), Slot(3.0, 0.0, 2.5)], APART_M)


@pytest.mark.parametrize("radius_m", [0.9, 0.0, -3.0, math.nan])
def test_a_slot_inside_the_leaders_clearance_is_refused(radius_m: float) -> None:
    with pytest.raises(EchowingError, match="slot 1 has a radius"):
        check_formation([Slot(radius_m)], APART_M)


@pytest.mark.parametrize("angle_deg", [91.0, -180.0])
def test_a_slot_ahead_of_the_leader_is_refused(angle_deg: float) -> None:
    with pytest.raises(EchowingError, match="ahead of the leader"):
        check_formation([Slot(3.0, math.radians(angle_deg))], APART_M)


def test_a_slot_behind_another_is_placed_from_there_and_may_be_as_near_as_it_is_ranged() -> None:
    column = [Slot(3.0), Slot(3.0, behind=0), Slot(4.0, math.radians(90.0), behind=1)]
    assert place_m(column, 2) == pytest.approx((-6.0, 4.0, 0.0))
    check_formation(column, 2.9)
    check_formation(column[:2], 4.83)


@pytest.mark.parametrize("behind", [1, 2, -1])
def test_a_slot_is_behind_one_before_it(behind: int) -> None:
    with pytest.raises(EchowingError, match="slot 2 is behind slot"):
        check_formation([Slot(3.0), Slot(3.0, behind=behind), Slot(8.0)], APART_M)


def test_the_field_tool_takes_no_slot_behind_another_yet(tmp_path: Path) -> None:
    file = tmp_path / "column.toml"
    file.write_text("[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 3.0\nbehind = 1\n")
    with pytest.raises(EchowingError, match="`behind`, which is for simulated flights"):
        load_formation(file, 1.0)


def test_an_empty_formation_is_refused() -> None:
    with pytest.raises(EchowingError, match="no slots"):
        check_formation([], APART_M)


def test_receivers_demand_what_is_certain_once_both_are_in_their_slots() -> None:
    # A metre, two receivers at 2.5 standard deviations (2.83 m), each half a metre off its slot.
    assert receivers_demand_m(1.0) == pytest.approx(4.83, abs=0.01)
    nearer_m = SURE_SIGMAS * UNRANGED_SIGMA_M
    certain_m = certain_distance_m(
        Other("b", (receivers_demand_m(1.0), 0.0, 0.0), (0.0, 0.0, 0.0), nearer_m, 0.0)
    )
    assert certain_m == pytest.approx(1.0 + 2.0 * IN_SLOT_M)


ENDS = ["--leader", "udpin:1@1", "--follower", "udpin:1@2", "--follower", "udpin:1@3"]


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        # Line astern at 4 m from one to the next came to 0.46 m.
        ("[[slots]]\nradius_m = 4.0\n[[slots]]\nradius_m = 8.0\n", "4.00 m apart, less than 4.83"),
        ("[[slots]]\nradius_m = 4.0\n[[slots]]\nradius_m = 9.0\n", None),
        ("slot_separation_m = 4\n[[slots]]\nradius_m = 4.0\n[[slots]]\nradius_m = 8.0\n", None),
        (
            "slot_separation_m = 6\n[[slots]]\nradius_m = 4.0\n[[slots]]\nradius_m = 9.0\n",
            "5.00 m apart, less than 6.00",
        ),
    ],
)
def test_follow_refuses_slots_nearer_than_that_unless_it_is_told(
    text: str, refused: str | None, tmp_path: Path
) -> None:
    formation = tmp_path / "line.toml"
    formation.write_text(text, encoding="utf-8")
    ends = [*ENDS, "--formation", str(formation)]
    if refused is None:
        assert len(options_of(ends).slots) == 2
        return
    with pytest.raises(EchowingError, match=refused):
        options_of(ends)


def test_the_field_tools_need_no_simulator(tmp_path: Path) -> None:
    """Nor does `follow` with a formation file."""
    formation = tmp_path / "vee.toml"
    formation.write_text("[[slots]]\nradius_m = 4.0\n[[slots]]\nradius_m = 9.0\n", encoding="utf-8")
    ends = [*ENDS, "--formation", str(formation)]
    code = (
        "import sys\n"
        "import echowing.tool.run, echowing.tool.leader, echowing.setup.job\n"
        "import echowing.web.live, echowing.web.recording, echowing.commands.analyze\n"
        "from echowing.commands.follow import options_of\n"
        f"assert len(options_of({ends!r}).slots) == 2\n"
        "print([name for name in sys.modules if name.startswith('echowing.sim')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.strip() == "[]"
