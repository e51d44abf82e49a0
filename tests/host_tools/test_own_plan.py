"""A plan of the user's own: a Python file in place of ours, in a scenario and in the table."""

import json
import math
import re
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from echowing.bench.laws import fly_law, rows
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.sim.flight import FormationFlight
from echowing.sim.own_plan import OwnPlan, OwnPlanStep, Seen, Wish
from echowing.sim.scenario import load_scenario

pytestmark = pytest.mark.seconds(15)

OURS = "return seen.ours"
AT_WHOM_IT_WATCHES = """\
north_m, east_m = seen.to_watched_m
    return (north_m, east_m), (2 * north_m, 2 * east_m)"""
COLUMN = [f"formation.{one}" for one in ("shape=column", "followers=2", "spacing_m=3")]
SEEN = Seen(
    time_s=12.3,
    system_id=2,
    own_mps=(0.0, 0.0),
    radius_m=3.0,
    to_watched_m=(3.0, 0.0),
    watched_mps=(0.0, 0.0),
    to_slot_m=(0.0, 0.0),
    slot_mps=(0.0, 0.0),
    hears=True,
    sigma_m=0.1,
    ours=((1.0, 2.0), (3.0, 4.0)),
)


def plan(folder: Path, deed: str) -> Path:
    """A user's file, whose function does this."""
    return written(folder, f"def plan(seen):\n    {deed}\n")


def written(folder: Path, text: str) -> Path:
    file = folder / "my_plan.py"
    file.write_text(text, encoding="utf-8")
    return file


def flown(capsys: pytest.CaptureFixture[str], *options: str | Path) -> dict[str, Any]:
    assert main(["sim", "echowing", "--duration", "30", "--json", *map(str, options)]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


def flight_with(file: Path, *changes: str) -> FormationFlight:
    return FormationFlight(load_scenario("echowing", [f'plan="{file}"', *changes]), 1)


def last_seen(*changes: str) -> tuple[FormationFlight, Seen]:
    """A flight at its end, and what the plan of its last follower was told then."""
    seen: list[Seen] = []

    def keep(one: Seen) -> Wish:
        seen.append(one)
        return one.ours

    flight = FormationFlight(load_scenario("echowing", ["gps.sigma_m=0", *changes]), 1)
    flight.ground.session.plan = OwnPlanStep(keep, flight.ground.session)
    flight.run()
    return flight, seen[-1]


def test_one_that_says_what_ours_says_flies_as_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours, same = flown(capsys), flown(capsys, "--plan", plan(tmp_path, OURS))
    assert (ours.pop("law"), same.pop("law")) == ("hold", "hold + my_plan.py")
    del ours["wall_s"], same["wall_s"]
    assert same == ours


def test_the_example_of_the_page_flies_as_it_stands_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[2] / "host_tools" / "LAWS.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert flown(capsys, "--plan", written(tmp_path, example))["mean_separation_m"] < 4.0


def test_all_that_it_is_told_is_on_the_page() -> None:
    page = (Path(__file__).parents[2] / "host_tools" / "LAWS.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| (`[a-z_`, ]+`) \|", page.partition("| of `seen`")[2], re.MULTILINE)
    assert {name for row in told for name in re.findall(r"\w+", row)} == {
        one.name for one in fields(Seen)
    }


def test_what_the_file_says_is_flown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At half of its leader's velocity it is left behind."""
    slow = plan(tmp_path, "return (0, 0), [mps / 2 for mps in seen.watched_mps]")
    assert flown(capsys, "--law", "none", "--plan", slow)["mean_separation_m"] > 5.0


@pytest.mark.parametrize("law", ["hold", "none"])
def test_one_that_flies_at_its_leader_is_kept_off(law: str, tmp_path: Path) -> None:
    """The envelope comes after it, with an applet that keeps a distance and without."""
    flight = flight_with(plan(tmp_path, AT_WHOM_IT_WATCHES), f"law={law}", "duration_s=40")
    assert flight.run().closest_m > 1.0


def test_it_is_told_what_is_known() -> None:
    flight, seen = last_seen("duration_s=30")
    leader, follower = flight.leader.body, flight.followers[0].body
    apart_m = leader.north_m - follower.north_m, leader.east_m - follower.east_m
    assert seen.time_s == pytest.approx(30.0, abs=0.2)
    assert (seen.system_id, seen.radius_m, seen.hears) == (2, 3.0, True)
    assert seen.to_watched_m == pytest.approx(apart_m, abs=0.5)
    assert seen.watched_mps == pytest.approx((leader.vn_mps, leader.ve_mps), abs=0.3)
    assert seen.own_mps == pytest.approx((follower.vn_mps, follower.ve_mps), abs=0.3)
    assert seen.slot_mps == pytest.approx(seen.watched_mps, abs=0.3)
    assert math.dist(seen.to_watched_m, seen.to_slot_m) == pytest.approx(3.0, abs=0.3)
    assert 0.0 < seen.sigma_m < 1.0


def test_in_a_line_it_is_told_of_the_one_ahead() -> None:
    _, seen = last_seen(*COLUMN, "duration_s=20")
    assert seen.system_id == 3
    assert math.hypot(*seen.to_watched_m) == pytest.approx(3.0, abs=1.0)


def test_who_is_held_is_not_asked(tmp_path: Path) -> None:
    file = plan(tmp_path, f"assert seen.time_s < 20; {OURS}")
    flight = flight_with(file, "duration_s=25")
    while flight.t_s < 19.9:
        flight.step()
    flight.ground.session.stop("a test")
    flight.run()


def test_each_flight_runs_the_file_anew(tmp_path: Path) -> None:
    """What it keeps of one flight would change the next: a seed would not fly the same twice."""
    kept = "kept = []\ndef plan(seen):\n    kept.append(seen.time_s)\n"
    file = written(tmp_path, f"{kept}    assert kept == sorted(kept)\n    {OURS}\n")
    for _ in range(2):
        flight_with(file, "duration_s=10").run()


def test_it_may_have_classes_of_its_own(tmp_path: Path) -> None:
    head = "from __future__ import annotations\nfrom dataclasses import dataclass\n@dataclass\n"
    file = written(tmp_path, f"{head}class Mine:\n    a: int\ndef plan(seen):\n    {OURS}\n")
    assert OwnPlan(file)(SEEN) == SEEN.ours


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "my_plan.py: cannot read the plan: [Errno 2] No such file"),
        ("x = 1\n", "my_plan.py: expected a function plan(seen) of one argument"),
        ("def plan():\n    pass\n", "my_plan.py: expected a function plan(seen) of one argument"),
        ("plan = 3\n", "my_plan.py: expected a function plan(seen) of one argument"),
        ("\ndef plan(seen)\n", "my_plan.py, line 2: failed as it was read: SyntaxError: expected"),
        ("import none_such\n", "my_plan.py, line 1: failed as it was read: ModuleNotFoundError"),
    ],
)
def test_a_file_that_is_no_plan_is_named_before_anything_flies(
    text: str | None, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my_plan.py" if text is None else written(tmp_path, text)
    for verb in (["sim", "echowing"], ["bench", "--only", "laws"]):
        assert main([*verb, "--plan", str(file)]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert says in line


@pytest.mark.parametrize(
    ("deed", "says"),
    [
        ("return 1 / 0", "line 2: plan(seen) failed after 12.3 s: ZeroDivisionError: division by"),
        ("pass", "plan(seen) returned None after 12.3 s; expected ((north_m, east_m), (north_mps"),
        ("return 1, 2", "returned (1, 2) after 12.3 s; expected ((north_m"),
        ("return (1, 2, 3), (0, 0)", "returned ((1, 2, 3), (0, 0)) after"),
        ("return (0, 0), (float('nan'), 0)", "returned ((0, 0), (nan, 0)) after"),
        ("return (0, 0), (0, 31)", "at most 30 m/s"),
        ("return (-101, 0), (0, 0)", "a place within 100 m of the follower"),
    ],
)
def test_what_it_says_wrongly_is_named(deed: str, says: str, tmp_path: Path) -> None:
    own = OwnPlan(plan(tmp_path, deed))
    with pytest.raises(EchowingError) as error:
        own(SEEN)
    assert str(error.value).startswith(str(tmp_path / "my_plan.py"))
    assert says in str(error.value)


def test_one_that_fails_is_no_flight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = plan(tmp_path, f"if seen.time_s > 5: nothing()\n    {OURS}")
    assert main(["sim", "echowing", "--plan", str(file)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "my_plan.py, line 2: plan(seen) failed after 5.1 s: NameError: name 'nothing'" in line


def test_it_stands_in_the_table_beside_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("echowing.bench.laws.DURATION_S", 15.0)
    mine = fly_law(str(plan(tmp_path, OURS)), "rectangle", 1)
    flights = [replace(mine, law="hold"), mine]
    assert [row.law for row in islice(rows(flights), 2)] == ["hold", "hold + my_plan.py"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (("law=bands",), "plan: needs points with a velocity"),
        (("law=none", "guidance.gray=true"), "plan: needs points with a velocity"),
        (("law=none", "kind=wall"), "plan: only for a formation behind a leader"),
        (("swarm.followers=3",), "plan: only for a formation behind a leader"),
        (("plan=vee.toml",), "plan: give a .py file"),
    ],
)
def test_where_it_would_not_be_flown_it_is_refused(
    changes: tuple[str, ...], says: str, tmp_path: Path
) -> None:
    file = plan(tmp_path, OURS)
    with pytest.raises(EchowingError, match=says):
        load_scenario("echowing", [f'plan="{file}"', *changes])


def test_it_is_not_for_other_tools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There `follow` plans."""
    assert main(["sim", "--serve", "5760", "--plan", str(plan(tmp_path, OURS))]) == 2
    assert "--serve: `follow` flies by its own plan" in capsys.readouterr().err
