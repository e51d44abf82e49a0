import math
import subprocess
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import pytest

from echowing.commands.follow import options_of
from echowing.errors import EchowingError
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import SURE_SIGMAS, Other, certain_distance_m
from echowing.flight.formation import (
    IN_SLOT_M,
    check_formation,
    flown_up,
    receivers_demand_m,
    sonars_demand_m,
)
from echowing.flight.guidance import Slot, place_m
from echowing.flight.shapes import SHAPES, shape
from echowing.sim.scenario import load_scenario
from echowing.sonar_file import shipped_sonar
from echowing.tool.formation_file import FormationSection, load_formation

APART_M = 2.0
RIGHT_RAD = math.radians(90.0)
FAR = (
    "the sonar's file does not carry it: "
    "a leader is certain to be heard up to 4.2 m, and no further"
)


def checked(slots: Sequence[Slot], separation_m: float | None = None) -> list[str]:
    return check_formation(slots, shipped_sonar(), 1.0, separation_m)


def test_slots_apart_are_accepted() -> None:
    checked([Slot(3.0), Slot(6.0, math.radians(60.0)), Slot(6.0, math.radians(-60.0))])


def test_two_slots_too_near_are_named_with_their_distance() -> None:
    with pytest.raises(EchowingError, match=r"slots 2 and 3 are 1\.00 m apart, less than 2\.00 m"):
        checked([Slot(3.0), Slot(6.0), Slot(7.0)], APART_M)


def test_a_simulated_formation_keeps_what_follow_demands() -> None:
    """The same file, the same demand: what is rehearsed is what is flown."""
    astern = "formation.slots=[{radius_m=4.0}, {radius_m=8.0}]"
    with pytest.raises(EchowingError, match=r"4\.00 m apart, less than 4\.83 m"):
        load_scenario("echowing", [astern])
    assert load_scenario("echowing", [astern, "formation.slot_separation_m=4"])


def test_altitude_steps_count() -> None:
    slots = [Slot(3.0, 0.6), Slot(3.0, -0.6, 2.5)]
    level_m = math.dist(place_m(slots, 0)[:2], place_m(slots, 1)[:2])
    assert math.dist(place_m(slots, 0), place_m(slots, 1)) == pytest.approx(
        math.hypot(level_m, 2.5)
    )


@pytest.mark.parametrize("radius_m", [0.9, 0.0, -3.0, math.nan])
def test_a_slot_inside_the_leaders_clearance_is_refused(radius_m: float) -> None:
    with pytest.raises(EchowingError, match="slot 1 has a radius"):
        checked([Slot(radius_m)])


@pytest.mark.parametrize("angle_deg", [91.0, -180.0])
def test_a_slot_ahead_of_the_leader_is_refused(angle_deg: float) -> None:
    with pytest.raises(EchowingError, match="ahead of the leader"):
        checked([Slot(3.0, math.radians(angle_deg))])


def test_a_slot_behind_another_is_placed_from_there_and_may_be_as_near_as_it_is_ranged() -> None:
    column = [Slot(3.0), Slot(2.5, behind=0), Slot(4.0, RIGHT_RAD, behind=1)]
    assert place_m(column, 2) == pytest.approx((-5.5, 4.0, 0.0))
    assert checked(column) == [f"slot 3: {FAR}"]
    column[2] = Slot(3.5, RIGHT_RAD, behind=1)
    assert checked(column) == []


@pytest.mark.parametrize("behind", [1, 2, -1])
def test_a_slot_is_behind_one_before_it(behind: int) -> None:
    with pytest.raises(EchowingError, match="slot 2 is behind slot"):
        checked([Slot(3.0), Slot(3.0, behind=behind), Slot(8.0)])


def test_sonars_between_two_followers_let_them_be_nearer_than_receivers_do() -> None:
    """One sonar leaves 0.37 m unsure, two half a metre, and so on, up to what receivers do."""
    demands_m = [sonars_demand_m(1.0, links) for links in range(1, 12)]
    assert demands_m[:3] == pytest.approx([2.93, 3.31, 3.60], abs=0.01)
    assert demands_m == sorted(demands_m)
    assert demands_m[-1] == receivers_demand_m(1.0)


@pytest.mark.parametrize(
    ("slots", "less_than"),
    [
        # 3.31 m: the two sonars that look at the leader; 3.60 m: three, on the way over the leader.
        ([Slot(3.0, 0.575), Slot(3.0, -0.575)], "slots 1 and 2 are 3.26 m apart, less than 3.31"),
        ([*shape("diamond", 3, 3.5)], "slots 1 and 3 are 3.50 m apart, less than 3.60"),
        # A sonar that does not reach whom it looks at ties nobody.
        ([Slot(5.0, 0.45), Slot(4.0, -0.45)], "slots 1 and 2 are 4.02 m apart, less than 4.83"),
        ([Slot(3.0), Slot(4.75, behind=0)], "slots 1 and 2 are 4.75 m apart, less than 4.83"),
        # Round by the side, and back to the leader.
        (
            [Slot(3.0, RIGHT_RAD), Slot(3.0, 0.0, behind=0), Slot(2.9, -RIGHT_RAD, behind=1)],
            "the leader and slot 3 are 3.00 m apart, less than 3.60",
        ),
    ],
)
def test_two_are_as_far_apart_as_the_sonars_between_them_demand(
    slots: list[Slot], less_than: str
) -> None:
    with pytest.raises(EchowingError, match=less_than):
        checked(slots)


def test_sonars_that_make_it_certain_are_enough() -> None:
    checked([Slot(3.0, 0.6), Slot(3.0, -0.6)])  # 3.39 m
    checked(shape("diamond", 3, 3.65))


def test_nobody_stands_in_a_beam() -> None:
    with pytest.raises(EchowingError, match="slot 1 is in the beam between slot 2 and the leader"):
        checked([Slot(2.0), Slot(4.5)], 1.0)
    beside = [Slot(3.0), Slot(2.5, behind=0), Slot(4.5, 0.15, behind=0)]
    with pytest.raises(EchowingError, match="slot 2 is in the beam between slot 3 and slot 1"):
        checked(beside, 0.5)
    checked([Slot(2.0), Slot(4.5, 1.0)], 1.0)


def test_no_two_sonars_face_each_other() -> None:
    """The left one looks to the right, and the right one to the left: past the leader."""
    with pytest.raises(EchowingError, match="sonars of slots 1 and 2 face each other within 9 m"):
        checked([Slot(3.0, RIGHT_RAD), Slot(3.0, -RIGHT_RAD)])
    checked([Slot(3.0, math.radians(75.0)), Slot(3.0, -math.radians(60.0))])
    checked([Slot(4.6, RIGHT_RAD), Slot(4.6, -RIGHT_RAD)])


@pytest.mark.parametrize(
    ("slots", "says"),
    [
        ([Slot(3.0), Slot(3.0, 0.0, 2.5)], r"slot 1 is 2\.5 m below slot 2, in the wash"),
        ([Slot(1.5, 0.0, -3.0)], r"slot 1 is 3\.0 m below the leader, in the wash"),
        ([Slot(3.0), Slot(1.9, 0.0, -4.0, behind=0)], r"slot 2 is 4\.0 m below slot 1"),
    ],
)
def test_nobody_flies_in_anothers_wash(slots: list[Slot], says: str) -> None:
    with pytest.raises(EchowingError, match=says):
        checked(slots)
    checked([Slot(3.0), Slot(3.0, 0.0, -1.0, behind=0)])


def test_what_costs_accuracy_is_told() -> None:
    assert checked([Slot(3.5)]) == []
    assert checked([Slot(3.0), Slot(8.0), Slot(13.0), Slot(18.0)]) == [
        "slots 2 to 4: beyond the sonar's reach of 4.5 m, by GPS alone"
    ]
    assert checked([Slot(4.0), Slot(4.0, behind=0)]) == [f"slots 1, 2: {FAR}"]
    (line,) = checked([*shape("vee", 4, 3.0), Slot(9.0)])[1:]
    assert line.startswith("slots 1, 2: their sonars look at one vehicle, and may hear")


def test_the_field_tool_takes_no_slot_behind_another_yet(tmp_path: Path) -> None:
    file = tmp_path / "column.toml"
    file.write_text("[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 3.0\nbehind = 1\n")
    for formation in (str(file), "column"):
        with pytest.raises(EchowingError, match="`behind`, which is for simulated flights"):
            options_of([*ENDS, "--formation", formation])


def test_an_empty_formation_is_refused() -> None:
    with pytest.raises(EchowingError, match="no slots"):
        checked([])


def test_receivers_demand_what_is_certain_once_both_are_in_their_slots() -> None:
    # A metre, two receivers at 2.5 standard deviations (2.83 m), each half a metre off its slot.
    assert receivers_demand_m(1.0) == pytest.approx(4.83, abs=0.01)
    nearer_m = SURE_SIGMAS * UNRANGED_SIGMA_M
    certain_m = certain_distance_m(
        Other("b", (receivers_demand_m(1.0), 0.0, 0.0), (0.0, 0.0, 0.0), nearer_m, 0.0)
    )
    assert certain_m == pytest.approx(1.0 + 2.0 * IN_SLOT_M)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_flown_up_so_large_that_receivers_tell_its_followers_apart(name: str) -> None:
    """4.8 m apart, and 2.8 m by which their reports err."""
    slots = shape(name, 5, 3.0)
    places_m = [place_m(flown_up(slots, 1.0), number) for number in range(5)]
    nearest_m = min(math.dist(*pair) for pair in combinations(places_m, 2))
    assert nearest_m == pytest.approx(7.66, abs=0.01)
    # Not larger than need be, and no smaller than it is flown.
    far = shape(name, 5, 8.0)
    assert flown_up(far, 1.0) == list(far)


def test_height_counts_where_a_shape_is_flown_up() -> None:
    slots = [Slot(3.0, 0.6), Slot(3.0, -0.6, 2.5)]
    nearest_m = math.dist(*(place_m(flown_up(slots, 1.0), number) for number in range(2)))
    assert nearest_m == pytest.approx(7.66, abs=0.01)


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


def test_follow_flies_a_shape_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    vee = options_of([*ENDS, "--formation", "vee"]).slots
    assert vee == list(shape("vee", 2, 3.0))
    assert "echowing: slots 1, 2: their sonars look at one vehicle" in capsys.readouterr().err
    assert options_of([*ENDS, "--formation", "vee", "--spacing", "4"]).slots[0].radius_m == 4.0
    nearer = options_of([*ENDS, "--formation", "vee", "--build-up", "8,5,3"])
    assert [slot.radius_m for slot in nearer.slots] == [8.0, 8.0]


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ([*ENDS[:4], "--radius", "4"], [f"slot 1: {FAR}"]),
        # Of each radius on the way, not of the last alone; and each once.
        (
            [*ENDS[:4], "--build-up", "5,4,3"],
            ["slot 1: beyond the sonar's reach of 4.5 m", f"slot 1: {FAR}"],
        ),
        ([*ENDS[:4], "--radius", "3"], []),
    ],
)
def test_follow_tells_a_single_follower_too_what_its_sonar_does_not_carry(
    told: list[str], says: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    options_of(told)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(says)
    assert all(one in line for one, line in zip(says, lines, strict=True))


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (["--formation", "vee", "--spacing", "0.5"], r"vee: a spacing of 0\.5 m: give 1 m or more"),
        (
            ["--formation", "vee", "--spacing", "2.8"],
            r"formation vee: .* 3\.21 m apart, ",
        ),
        (["--spacing", "4"], "--spacing needs --formation column or vee"),
        ([], "2 followers need --formation: column, vee, echelon, abreast, diamond, or a FILE"),
        (["--formation", "vees"], "--formation vees: cannot be read"),
    ],
)
def test_follow_says_what_is_wrong_with_a_shape(told: list[str], says: str) -> None:
    with pytest.raises(EchowingError, match=says):
        options_of([*ENDS, *told])


def test_a_formation_file_may_name_a_shape(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    text = 'shape = "vee"\nfollowers = 2\nspacing_m = 3.5\n'
    file.write_text(text, encoding="utf-8")
    assert options_of([*ENDS, "--formation", str(file)]).slots == list(shape("vee", 2, 3.5))
    file.write_text(text.replace("2", "3"), encoding="utf-8")
    with pytest.raises(EchowingError, match="3 slots for 2 followers"):
        options_of([*ENDS, "--formation", str(file)])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('shape = "vee"\n', "formation: a shape needs shape, followers, spacing_m; here: shape"),
        ("followers = 3\n", "here: followers"),
        ('shape = "ring"\nfollowers = 2\nspacing_m = 3\n', "shape: Input should be 'column', "),
        ('shape = "vee"\nfollowers = 13\nspacing_m = 3\n', "followers: .* equal to 12"),
        (
            'shape = "vee"\nfollowers = 1\nspacing_m = 3\n[[slots]]\nradius_m = 3.0\n',
            "formation: give a shape or slots, not both",
        ),
    ],
)
def test_a_formation_is_a_shape_or_slots(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(EchowingError, match=says) as error:
        load_formation(file)
    assert "\n" not in str(error.value), "one fault, one line"


def test_a_shape_stays_a_shape_where_a_scenario_is_written_down() -> None:
    told = {"shape": "vee", "followers": 3, "spacing_m": 3.0}
    formation = FormationSection.model_validate(told)
    assert [section.slot() for section in formation.slots] == list(shape("vee", 3, 3.0))
    assert formation.model_dump(exclude_unset=True) == told


@pytest.mark.parametrize("name", SHAPES)
def test_there_is_a_scenario_for_each_shape(name: str) -> None:
    scenario = load_scenario(name, ["formation.followers=4", "formation.spacing_m=4.2"])
    assert scenario.slots() == list(shape(name, 4, 4.2))
    assert scenario.follower.target == "foil"


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
