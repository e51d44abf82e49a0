"""The planner: ties, what a formation lacks, the optimisers, and the verb."""

import json
import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.cloud import UNRANGED_SIGMA_M
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import check_formation, sonars_demand_m
from echowing.flight.guidance import place_m
from echowing.planning.cost import Formation, Limits
from echowing.planning.files import file_slots, formation_table
from echowing.planning.optimise import METHODS, Counted, SpentError, best_of, compare
from echowing.planning.pigeons import fly_home
from echowing.planning.ties import pair_links, pair_sigma_m, tie_sigma_m, watched
from echowing.sim.scenario import load_scenario
from echowing.sonar_file import load_sonar, shipped_sonar
from echowing.tool.formation_file import check_to_be_led, load_formation

LIMITS = Limits(2, shipped_sonar())
# Two behind the leader and one behind both: (back, right) metres.
DIAMOND = ((2.6, -1.6), (2.6, 1.7), (5.4, 0.2))


def formation(*back_right: tuple[float, float], **changes: Any) -> Formation:
    places = np.array([(0.0, 0.0, 0.0), *((back, right, 0.0) for back, right in back_right)])
    return Formation(places, replace(LIMITS, followers=len(back_right), **changes))


# ---- ties ----------------------------------------------------------------------------------------


def test_a_pairs_uncertainty_is_the_sum_over_the_sonars_between() -> None:
    """0 - 1 - 2, and 3 on the leader: by hand."""
    tie_m = np.zeros((4, 4))
    tie_m[1, 0], tie_m[2, 1], tie_m[3, 0] = 0.3, 0.4, 0.5
    sigma_m = pair_sigma_m([0, 1, 0], tie_m)
    assert sigma_m[0, 1] == pytest.approx(0.3)
    assert sigma_m[2, 0] == pytest.approx(0.5)  # 0.3 and 0.4
    assert sigma_m[1, 3] == pytest.approx(math.sqrt(0.3**2 + 0.5**2))
    assert sigma_m[2, 3] == sigma_m.max() == pytest.approx(math.sqrt(0.5))
    assert (sigma_m == sigma_m.T).all()


def test_receivers_are_no_worse_than_without_sonars() -> None:
    tie_m = np.full((5, 5), 0.7)
    sigma_m = pair_sigma_m([0, 1, 2, 3], tie_m)
    assert sigma_m[0, 2] == pytest.approx(0.7 * math.sqrt(2.0))
    assert sigma_m[0, 3] == sigma_m[0, 4] == UNRANGED_SIGMA_M
    alone = formation((9.0, 0.0))  # in nobody's reach
    assert alone.sigma_m[0, 1] == UNRANGED_SIGMA_M
    assert alone.off_limits_m["somebody to watch"] == pytest.approx(5.5)


def test_a_sonar_watches_whom_it_sees_and_who_keeps_the_worst_pair_surest() -> None:
    tie_m, off_m = np.full((4, 4), 0.4), np.zeros((4, 4))
    assert watched(off_m, tie_m) == [0, 0, 0]
    off_m[2, 0] = off_m[3, 0] = 0.5
    # Three behind one another are two links from end to end; a fourth goes behind the middle one.
    assert watched(off_m, tie_m) == [0, 1, 1]
    off_m[3, 1] = 0.1
    assert watched(off_m, tie_m) == [0, 1, 2]


def test_a_nearer_vehicle_in_the_beam_is_in_the_way() -> None:
    """And once it is lost, it is not."""
    column = formation((2.0, 0.1), (4.0, 0.0), spacing_m=(1.5, 4.0))
    assert column.watches == [0, 1]
    assert column.off_m[2, 0] > 0.5
    assert column.left_alone == {}  # at 4 m the leader is certain to be heard
    assert column.spare(2) == 0
    aside = formation((2.0, 1.6), (3.9, 0.0), spacing_m=(1.5, 4.0))
    assert aside.off_m[2, 0] == 0.0


def test_nobody_watches_who_is_aside_behind_or_too_high() -> None:
    two = formation((1.0, 3.0), (3.0, 0.0))
    assert two.off_m[1, 0] > 0.0  # 72 degrees off the course
    assert two.off_m[2, 0] == 0.0
    assert two.off_m[1, 2] > 3.0
    places = np.array([(0.0, 0.0, 0.0), (2.4, 0.0, 2.0)])
    assert Formation(places, replace(LIMITS, followers=1)).off_m[1, 0] > 0.0


def test_sonars_between_two_are_counted() -> None:
    """0 - 1 - 2, 3 on the leader, 4 behind 3."""
    links = pair_links([0, 1, 0, 3])
    assert links[0].tolist() == [0, 1, 2, 1, 2]
    assert links[2].tolist() == [2, 1, 0, 3, 4]
    assert (links == links.T).all()


# ---- losses --------------------------------------------------------------------------------------


def test_a_loss_leaves_alone_who_has_nobody_else_within_reach() -> None:
    column = formation((3.0, 0.0), (6.0, 0.0), (9.0, 0.0))
    assert column.is_within_limits
    assert column.left_alone == {1: [2], 2: [3]}
    diamond = formation(*DIAMOND)
    assert diamond.left_alone == {}
    assert {diamond.spare(3), diamond.watches[2]} == {1, 2}
    narrow = formation(*DIAMOND, view_rad=math.radians(30.0))
    assert 3 in narrow.left_alone[narrow.watches[2]]
    assert column.cost > 10.0  # of which a metre is what its pairs are unsure of


def test_after_any_loss_everybody_has_somebody_to_watch() -> None:
    """Each one left sees a vehicle ahead of it: followed forward, every way ends at the leader."""
    planned = best_of(replace(LIMITS, followers=4), "evolution", 4000, 1)
    assert planned.left_alone == {}
    for lost in range(1, 5):
        for one in set(range(1, 5)) - {lost}:
            watches = planned.watches[one - 1]
            its = planned.spare(one) if watches == lost else watches
            assert its is not None and its != lost
            assert planned.places_m[its, 0] < planned.places_m[one, 0]
            assert planned.geometry.far_m[one, its] <= 4.2 + 0.01


# ---- limits --------------------------------------------------------------------------------------


def test_two_followers_both_watch_the_leader() -> None:
    """One behind the other is worse by the greater distance between the ends."""
    planned = best_of(LIMITS, "annealing", 1500, 1)
    assert planned.watches == [0, 0]
    column = formation((3.0, 0.0), (6.0, 0.0))
    assert column.watches == [0, 1]
    assert planned.sigma_m.max() <= column.sigma_m.max() + 0.005
    assert planned.left_alone == {} != column.left_alone


@pytest.mark.parametrize(
    "changes",
    [
        {"followers": 4},
        {"followers": 3, "heights_m": (-0.5, 0.0, 0.5), "spacing_m": (3.1, 3.4)},
        {"followers": 2, "keep_out_rad": math.radians(150.0), "angle_rad": math.radians(50.0)},
        {"followers": 3, "leader_only": True, "angle_rad": math.radians(80.0)},
        {"followers": 4, "spacing_m": (2.0, 3.5)},
    ],
)
def test_limits_are_kept(changes: dict[str, Any]) -> None:
    limits = replace(LIMITS, **changes)
    planned = best_of(limits, "evolution", 1500, 1)
    slots = planned.slots()
    (least_m, most_m), angle_deg = limits.spacing_m, math.degrees(limits.angle_rad)
    places = [(0.0, 0.0, 0.0), *(place_m(slots, n) for n in range(len(slots)))]
    assert planned.is_within_limits
    for a, b in combinations(range(len(places)), 2):
        assert math.dist(places[a], places[b]) >= least_m - 0.01
        assert planned.certain_m[a, b] >= LEAST_M - 0.01
    for slot, its, place in zip(slots, planned.watches, places[1:], strict=True):
        assert math.dist(place, places[its]) <= most_m + 0.01
        assert abs(math.degrees(slot.angle_rad)) <= angle_deg + 0.5
        assert slot.altitude_step_m in limits.heights_m
        off_nose_deg = abs(math.degrees(math.atan2(place[1], place[0])))
        assert off_nose_deg >= math.degrees(limits.keep_out_rad) - 0.5
    if limits.leader_only:
        assert planned.watches == [0, 0, 0]
    check_formation(slots, limits.sonar, LEAST_M)


def test_what_follow_demands_of_two_is_a_limit() -> None:
    """At 2 m the sonars leave less open than `follow` reckons with: by that they are 1 m apart."""
    two = formation((1.4, -1.45), (1.4, 1.45), leader_only=True, spacing_m=(2.0, 3.5))
    assert two.off_limits_m["certain distance"] == 0.0
    lacking_m = sonars_demand_m(LEAST_M, 2) - 2.9
    assert two.off_limits_m["what follow demands"] == pytest.approx(lacking_m, abs=0.021)
    assert not two.is_within_limits
    with pytest.raises(EchowingError, match=r"slots 1 and 2 are 2\.90 m apart"):
        file_slots(two)


def test_millimetres_do_not_bring_a_file_under_the_limit() -> None:
    """On the limit to a centimetre, and rounded."""
    half_m = (sonars_demand_m(LEAST_M, 2) + 0.011) / 2.0
    off = formation((2.5, -half_m), (2.5, half_m), leader_only=True)
    assert off.is_within_limits
    assert all("slot" not in key for key in formation_table(file_slots(off)) if key != "slots")


def test_what_is_off_a_limit_is_named() -> None:
    near = formation((3.0, -0.5), (3.0, 0.5))
    assert near.off_limits_m["least spacing"] == pytest.approx(2.0)
    assert near.off_limits_m["certain distance"] > 1.0
    wide = formation((1.5, 2.6), keep_out_rad=math.radians(140.0))
    assert wide.off_limits_m["keep-out"] == pytest.approx(math.radians(20.0) * 3.0, abs=0.02)
    # Level with its own sonar's figures: at 3 m, 0.37 m.
    assert tie_sigma_m(np.array([3.0]))[0] == pytest.approx(0.368, abs=0.001)


# ---- optimisers ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_each_method_spends_what_it_is_given_and_finds_two(method: str) -> None:
    first, again = (best_of(LIMITS, method, 800, 3) for _ in range(2))
    assert (first.places_m == again.places_m).all()
    assert first.is_within_limits
    few = best_of(LIMITS, method, 1, 3)
    assert few.cost > first.cost


def test_the_cost_ends_after_so_many_and_keeps_the_best() -> None:
    cost = Counted(LIMITS, 3)
    values = [cost(np.full(6, share)) for share in (0.2, 0.5, 0.9)]
    assert cost.best is not None
    assert cost.best.cost == min(values)
    with pytest.raises(SpentError):
        cost(np.full(6, 0.5))


def test_pigeons_come_home() -> None:
    """To the least of a bowl, nearer than chance alone: 0.3 for 7,500 throws in four unknowns."""
    home = np.array([0.3, 0.7, 0.5, 0.2])
    found = fly_home(lambda at: float(((at - home) ** 2).sum()), 4, np.random.default_rng(1))
    assert np.abs(found - home).max() < 0.02


def test_methods_are_compared_on_the_same_formations() -> None:
    rows = list(compare(LIMITS, (1, 2), (1, 2), 60))
    assert [(row.followers, row.method) for row in rows] == [
        (number, method) for number in (1, 2) for method in METHODS
    ]
    for row in rows:
        assert len(row.found) == len(row.costs_m) == 2
        assert row.spared <= row.kept <= 2
    assert rows[0].kept == 2  # one follower is easily placed


# ---- the verb ------------------------------------------------------------------------------------

FEW = ("--evaluations", "500")


def test_files_are_read_back_and_the_same_seed_gives_the_same_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        files = [f"--{option}={tmp_path / name}.{option}" for option in ("out", "scenario", "plot")]
        assert main(["plan", "3", *FEW, "--seed", "5", "--json", *files]) == 0
    printed = capsys.readouterr().out
    assert printed[: len(printed) // 2] == printed[len(printed) // 2 :]
    for option in ("out", "scenario", "plot"):
        one, other = (tmp_path / f"{name}.{option}" for name in "ab")
        assert one.read_bytes() == other.read_bytes()
    assert (tmp_path / "a.plot").read_text().startswith("<svg")
    (tmp_path / "a.scenario").rename(tmp_path / "a.toml")
    flight = load_scenario(str(tmp_path / "a.toml"))
    flight.check_formation()
    found = json.loads(printed[: len(printed) // 2])
    for slot, told in zip(flight.slots(), found["slots"], strict=True):
        assert slot.radius_m == pytest.approx(told["radius_m"], abs=0.001)
        assert slot.behind == told["behind"]
    assert "slot_separation_m" not in (tmp_path / "a.out").read_text()


@pytest.mark.parametrize("spacing", ["3-3.5", "2-3.5", "2-2.4"])
def test_a_file_of_leader_only_is_flown_as_slots_by_hand_are(tmp_path: Path, spacing: str) -> None:
    """With real vehicles, and as far apart as `follow` demands by itself."""
    file = tmp_path / "two.toml"
    only = ("--leader-only", "--spacing", spacing)
    assert main(["plan", "2", *FEW, *only, "--out", str(file), "--json"]) == 0
    planned = load_formation(file)
    assert [slot.behind for slot in planned.slots] == [None, None]
    assert planned.slot_separation_m is None
    slots = [slot.slot() for slot in planned.slots]
    check_to_be_led(slots, shipped_sonar(), LEAST_M, planned.slot_separation_m)
    apart_m = math.dist(place_m(slots, 0), place_m(slots, 1))
    assert apart_m >= sonars_demand_m(LEAST_M, 2)


def test_the_table_tells_pairs_and_losses(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "2", *FEW]) == 0
    said = capsys.readouterr().out
    assert "leader and 1" in said and "sonar" in said
    assert "No single loss splits it" in said
    assert main(["plan", "2", *FEW, "--angle", "8", "--view", "8"]) == 0
    assert "The loss of 1 splits it: nobody to watch is left for 2." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["0"], "0 followers: give 1 to 12"),
        (["13"], "13 followers: give 1 to 12"),
        (["2", "--spacing", "4-3"], "spacing 4-3: give the least"),
        (["2", "--spacing", "wide"], "--spacing: 'wide' is no number of metres"),
        (["2", "--spacing", "3-6"], "spacing 6 m: the sonar does not carry it"),
        (["2", "--heights", "0,nan"], "--heights: 'nan' is no number"),
        (["2", "--angle", "0"], "angle 0: give 1 to 90 degrees"),
        (["2", "--view", "120"], "view 120: give 1 to 90 degrees"),
        (["2", "--keep-out", "20"], "keep-out 20: give 90 to 179 degrees"),
        (["2", "--seed", "-1"], "--seed -1: give 0 or more"),
        (["2", "--evaluations", "0"], "--evaluations 0: give 1 or more"),
        (["2", "--method", "doves"], "--method doves: there are evolution"),
        (["2", "--legs", "stock"], "spacing 3 m: the sonar does not carry it"),
        (["8", "--leader-only", *FEW], "no formation of 8 keeps the limits"),
        # Nearer than 3.31 m `follow` flies no two that look at the leader.
        (["2", "--leader-only", "--spacing", "1.2-2", *FEW], "misses what follow demands by 0."),
        (["2", "--out", "/absent/a.toml", *FEW], "/absent/a.toml: cannot be written"),
    ],
)
def test_what_is_wrong_is_said(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_another_sonar_reaches_further() -> None:
    belief = replace(load_sonar("mb1202").belief(), heard_to_m=7.0)
    replace(LIMITS, sonar=belief, spacing_m=(3.0, 5.0)).check()
    with pytest.raises(EchowingError, match="spacing 5 m"):
        replace(LIMITS, spacing_m=(3.0, 5.0)).check()
