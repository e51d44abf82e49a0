"""The sonar measured on the bench: what is fitted is what was so, and the judgement follows."""

import json
import math
import random
from argparse import ArgumentTypeError, Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from echowing.analysis.sonar_fit import Tally, dependence, fitted, share_between
from echowing.analysis.sonar_measure import Conditions, Measured, Readings, measured_sonar
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.belief import Curve, SonarBelief
from echowing.rig.bench import Bench
from echowing.rig.response_matrix import (
    ANGLES_DEG,
    DISTANCES_M,
    Plan,
    ResponseMatrix,
    numbers,
    run,
)
from echowing.rig.result import Result
from echowing.sim.world.sonar import ON_A_DESK, TrueSonar
from echowing.sonar_file import Legs, SonarFile, fly_by, load_sonar, shipped_sonar

from .test_rig_procedures import FakeBoard, bench_of, done, value

BASE = load_sonar("mb1202")
HOVER = 0.4
# A beam that narrows, and hears less and less: nothing of it is in the shipped file.
TRUE = replace(
    ON_A_DESK,
    heard=Curve((1.0, 4.0), (0.95, 0.6)),
    half_rad=Curve((1.0, 4.0), (math.radians(18.0), math.radians(10.0))),
    edge_rad=math.radians(3.0),
    noise_m=0.02,
    wild_share=0.02,
    foil_m=4.2,
    inset_m=0.24,
)


class Hung(FakeBoard):
    """A board before a leader that hangs where it was put; it knows only what it was told."""

    def __init__(self, true: TrueSonar, seed: int = 1, runs_take: float = 0.7) -> None:
        super().__init__(self._pings)
        self.true, self.runs_take = true, runs_take
        self.chance = random.Random(seed)
        self.separation_m = math.nan
        self.throttle = 0.0
        self.pan_us = 1380.0
        self.aims: list[tuple[float, float]] = []
        self.moved_in_the_wash = False

    def aim(self, pan_us: float, tilt_us: float) -> None:
        self.pan_us = pan_us
        self.aims.append((pan_us, tilt_us))

    def _pings(self, t_s: float) -> Iterator[Any]:
        if round(t_s / 0.05) % 2:
            return
        yield value("SNR_RAW", self._ping_m())

    def _ping_m(self) -> float:
        true, chance = self.true, self.chance
        if chance.random() < true.wild_share:
            return chance.uniform(0.2, 7.65)
        range_m = self.separation_m - true.inset_m
        off_rad = math.radians(abs(self.pan_us - 1380.0) / 10.0)
        left = self.runs_take if self.throttle else 1.0
        heard = range_m <= true.foil_m and chance.random() < left * true.share(range_m, off_rad)
        return range_m + chance.gauss(0.0, true.noise_m) if heard else 7.66


class Helper:
    """The operator's hands: does what is asked."""

    def __init__(self, board: Hung) -> None:
        self.board, self.asked = board, list[str]()

    def ask(self, text: str, *_: object) -> None:
        self.asked.append(text)
        board = self.board
        if text.startswith("Propellers stand. Put the leader"):
            board.moved_in_the_wash |= board.throttle > 0.0
            board.separation_m = float(text.split("leader ")[1].split(" m", maxsplit=1)[0])
        elif "run the propellers at" in text:
            board.throttle = float(text.split(" at ")[1].split("%", maxsplit=1)[0]) / 100.0
        else:
            board.throttle = 0.0


def plan(**changes: Any) -> Plan:
    usual = Plan(DISTANCES_M, ANGLES_DEG, (0.0, HOVER), 20.0, Conditions("foil", HOVER, 3.0))
    return replace(usual, **changes)


def measure(board: Hung, wanted: Plan) -> tuple[ResponseMatrix, Result, Bench]:
    bench = bench_of(board)
    helper = Helper(board)
    bench.operator.ask = helper.ask  # type: ignore[assignment, method-assign]
    procedure = ResponseMatrix(wanted, BASE)
    procedure.run(bench)
    return procedure, procedure.result(), bench


@pytest.fixture(scope="module")
def measured() -> tuple[Hung, ResponseMatrix, Result]:
    board = Hung(TRUE)
    procedure, result, _ = measure(board, plan())
    return board, procedure, result


# ---- the fit -------------------------------------------------------------------------------------


def tallies(share: float, half_deg: float, edge_deg: float, pings: int = 2_000) -> list[Tally]:
    found = []
    for off_deg in (0.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 24.0):
        there = share / (1.0 + math.exp((off_deg - half_deg) / (0.5 * edge_deg)))
        found.append(Tally(3.0, off_deg, pings, round(there * pings)))
    return found


@pytest.mark.parametrize(
    ("share", "half_deg", "edge_deg"), [(0.9, 16.0, 3.0), (0.4, 8.0, 4.0), (1.0, 12.0, 1.0)]
)
def test_what_is_fitted_is_what_was_so(share: float, half_deg: float, edge_deg: float) -> None:
    fit = fitted(tallies(share, half_deg, edge_deg))
    (at,) = fit.at

    assert at.share == pytest.approx(share, abs=0.02)
    assert at.half_deg == pytest.approx(half_deg, abs=0.5)
    assert fit.edge_deg == edge_deg
    assert at.share_between[0] <= share <= at.share_between[1] + 0.01
    assert at.half_between_deg[0] <= half_deg <= at.half_between_deg[1]


def test_fewer_pings_and_pings_that_are_alike_tell_less() -> None:
    def widths(fit_of: list[Tally], alike: float = 1.0) -> tuple[float, float]:
        (at,) = fitted(fit_of, alike).at
        return (
            at.share_between[1] - at.share_between[0],
            at.half_between_deg[1] - at.half_between_deg[0],
        )

    many, few = tallies(0.7, 12.0, 3.0), tallies(0.7, 12.0, 3.0, pings=50)
    assert all(a < b for a, b in zip(widths(many), widths(few), strict=True))
    assert all(a < b for a, b in zip(widths(few), widths(few, 4.0), strict=True))


def test_nine_of_ten_intervals_hold_the_truth() -> None:
    chance, held = random.Random(3), 0

    def drawn(one: Tally, pings: int = 60) -> Tally:
        heard = sum(chance.random() < one.heard / one.pings for _ in range(pings))
        return replace(one, pings=pings, heard=heard)

    for _ in range(200):
        (at,) = fitted([drawn(one) for one in tallies(0.7, 12.0, 3.0)]).at
        held += at.half_between_deg[0] <= 12.0 <= at.half_between_deg[1]

    # 180 expected, and a few more by the grid's steps; standard deviation 4.
    assert 165 <= held <= 198


def test_where_hardly_anything_is_heard_no_angle_is_told() -> None:
    (at,) = fitted(tallies(0.02, 12.0, 3.0)).at

    assert at.half_deg is None


def test_bursts_make_pings_alike() -> None:
    chance = random.Random(5)
    alone = [[chance.random() < 0.5 for _ in range(400)]]
    in_bursts = [[chance.random() < 0.5] * 4 for _ in range(100)]

    assert dependence(alone) == pytest.approx(1.0, abs=0.15)
    # Each is three times of four as the one before: correlated by 0.75.
    assert dependence([[one for burst in in_bursts for one in burst]]) == pytest.approx(
        7.0, rel=0.3
    )
    assert dependence([]) == 1.0


def test_a_share_of_few_is_known_badly() -> None:
    assert share_between(0, 0) == (0.0, 1.0)
    low, high = share_between(50, 100)
    assert (low, high) == pytest.approx((0.42, 0.58), abs=0.01)
    assert share_between(0, 100)[1] == pytest.approx(0.026, abs=0.005)


# ---- the procedure -------------------------------------------------------------------------------


def test_the_file_says_what_the_sonar_is(measured: tuple[Hung, ResponseMatrix, Result]) -> None:
    _, procedure, _ = measured
    assert procedure.measured is not None
    file = procedure.measured.file
    fit = {at.range_m: at for at in procedure.measured.fit.at}

    # 0.7 of what is heard with the propellers still, at 2.76 m.
    true_share = 0.7 * TRUE.heard.at(2.76)
    assert fit[3.0].share == pytest.approx(true_share, abs=0.08)
    assert fit[3.0].half_deg == pytest.approx(math.degrees(TRUE.half_rad.at(2.76)), abs=1.0)
    assert file.inset_m == pytest.approx((0.22, 0.26), abs=0.005)
    assert file.noise_m[0] < 0.02 < file.noise_m[1]
    # The wild ones within half a metre of the leader are taken for it.
    assert file.wild_share[0] < 0.02 * (1.0 - 1.0 / 7.45) < file.wild_share[1]
    assert file.foil_to_m == pytest.approx((4.16, 4.16 * 1.05), abs=0.05)
    assert file.throttle.throttle == (0.0, HOVER)
    assert file.throttle.share == (1.0, 1.0)
    assert load_sonar("mb1202").reach_m == file.reach_m


def test_every_value_says_how_it_was_measured(
    measured: tuple[Hung, ResponseMatrix, Result],
) -> None:
    _, procedure, _ = measured
    assert procedure.measured is not None
    file = procedure.measured.file

    assert file.source["heard.least"].startswith("measured: bench, ")
    assert "pings at foil legs, throttle 0.4" in file.source["beam.narrowest_deg"]
    assert file.source["stock_to_m"].startswith("guess: in the proportion of --base; measured: ")
    assert file.source["reach_m"] == BASE.source["reach_m"]


def hung(legs: Legs, *, base: SonarFile = BASE, narrow_first: bool = False) -> Measured:
    """A leader with these legs, heard up to 3.2 m."""
    at_m = {1.2: 38, 2.2: 30, 3.2: 22, 4.2: 1}
    readings = [
        Readings(
            separation_m,
            off_deg,
            0.4,
            [[separation_m - 0.2] * round(heard * left) + [None] * (80 - round(heard * left))] * 4,
        )
        for separation_m, heard in at_m.items()
        for off_deg, left in (
            (0.0, 2.0),
            (8.0, 0.05 if narrow_first and separation_m < 2.0 else 1.9),
            (16.0, 0.1),
        )
    ]
    return measured_sonar(readings, base, Conditions(legs, 0.4, 2.0))


@pytest.mark.parametrize(
    ("distances_m", "reach_m", "says"),
    [
        ((2.0, 3.0), 4.5, "As it hears the leader at 3 m, the farthest distance, nobody knows"),
        ((2.0, 3.0), 2.5, "Although it hears the leader at 3 m, no range counts from 2.7 m on"),
        ((2.0, 3.0, 5.0), 4.5, ""),
    ],
)
def test_how_far_it_was_not_measured_is_said(
    distances_m: tuple[float, ...], reach_m: float, says: str
) -> None:
    procedure = ResponseMatrix(
        plan(distances_m=distances_m), BASE.model_copy(update={"reach_m": reach_m})
    )
    board = Hung(TRUE)
    bench = bench_of(board)
    bench.operator.ask = Helper(board).ask  # type: ignore[assignment, method-assign]
    procedure.run(bench)
    assert procedure.measured is not None

    assert [note[: len(says)] for note in procedure.measured.notes] == ([says] if says else [])


@pytest.mark.parametrize("legs", ["foil", "stock"])
def test_the_file_is_of_foil_whichever_legs_were_measured(legs: Legs) -> None:
    measured = hung(legs)
    belief, other = measured.file.belief(legs), measured.file.belief("foil")

    assert belief.heard_to_m == pytest.approx(3.0)
    # By the proportion of the shipped file; what is believed of foil is further away by as much.
    further = {"foil": 1.0, "stock": 4.4 / 3.1}[legs]
    assert other.heard_to_m == pytest.approx(3.0 * further, abs=0.01)
    for at in measured.fit.at[:3]:
        range_m = at.range_m - 0.2
        assert belief.heard.at(range_m) == pytest.approx(at.share_between[0], abs=0.01)
        assert other.heard.at(further * range_m) == pytest.approx(at.share_between[0], abs=0.01)
        narrowest_deg = math.degrees(belief.narrowest_rad.at(range_m))
        assert narrowest_deg == pytest.approx(at.half_between_deg[0], abs=0.1)
    assert belief.objection(2.2) is None
    told = measured.file.source["beam.range_m"]
    assert ("further for foil, as foil_to_m is to stock_to_m" in told) == (legs == "stock")


def test_no_beam_before_stock_legs_is_believed_narrower_than_it_was() -> None:
    measured = hung("stock", narrow_first=True)
    widest_rad = measured.file.belief("stock").widest_rad

    for at in measured.fit.at[:3]:
        assert math.degrees(widest_rad.at(at.range_m - 0.2)) >= at.half_between_deg[1]


@pytest.mark.parametrize(("first", "then"), [("foil", "stock"), ("stock", "foil")])
def test_what_was_measured_with_other_legs_stays(first: Legs, then: Legs) -> None:
    one = hung(first).file
    both = hung(then, base=one).file
    key = f"{first}_to_m"

    assert getattr(both, key) == getattr(one, key)
    assert both.source[key] == one.source[key]
    assert not {"foil_to_m", "stock_to_m"} & set(both.guesses)
    # Both are heard as far: what is heard of one is heard of the other.
    assert both.belief("stock").heard == both.belief("foil").heard


@pytest.mark.parametrize(("legs", "option"), [("foil", ""), ("stock", " --legs stock")])
def test_the_next_command_says_which_legs(legs: Legs, option: str) -> None:
    command = f"echowing follow --sonar 'my own.toml'{option}"

    assert fly_by(Path("my own.toml"), legs) == f"my own.toml: fly by it with `{command}`"


def test_the_leader_is_moved_only_while_the_propellers_stand(
    measured: tuple[Hung, ResponseMatrix, Result],
) -> None:
    board, _, _ = measured

    assert not board.moved_in_the_wash
    assert board.throttle == 0.0


def test_the_gimbal_turns_to_both_sides(measured: tuple[Hung, ResponseMatrix, Result]) -> None:
    board, _, _ = measured

    assert {pan_us for pan_us, _ in board.aims} == {
        1380.0 + side * 10.0 * angle for angle in ANGLES_DEG for side in (1.0, -1.0)
    }
    assert {tilt_us for _, tilt_us in board.aims} == {1400.0}


def test_a_sonar_that_carries_its_slot_passes(
    measured: tuple[Hung, ResponseMatrix, Result],
) -> None:
    _, _, result = measured

    assert result.verdict == "PASS", result.checks
    assert result.measured["sonar"]["heard"]["range_m"][0] == pytest.approx(0.76, abs=0.02)
    assert set(result.figures) == {"angle", "range"}
    assert "0.5 m" in result.notes[-1]


def test_one_that_does_not_is_told_which_it_carries() -> None:
    deaf = replace(TRUE, heard=Curve((1.0, 2.6, 3.0), (0.95, 0.9, 0.3)), foil_m=4.6)
    _, result, _ = measure(Hung(deaf), plan())

    (check,) = result.checks
    assert result.verdict == "FAIL"
    # At 3.7 m less than half is heard of what is heard near by; 0.7 m of that are room.
    assert check.found.startswith("the nearest is 2.2 m: a leader is certain to be heard up to 3.0")
    assert check.limit == "a slot of 3 m"


def test_without_propellers_nothing_is_proven() -> None:
    wanted = plan(throttles=(0.0,), conditions=Conditions("foil", 0.0, 3.0))
    procedure, result, _ = measure(Hung(TRUE), wanted)

    assert result.verdict == "INCOMPLETE"
    assert "the propellers stood" in str(result.incomplete)
    assert procedure.measured is not None


def test_throttle_that_takes_more_than_hover_is_in_the_file() -> None:
    class Louder(Hung):
        def _ping_m(self) -> float:
            self.runs_take = {0.0: 1.0, 0.4: 0.8, 0.7: 0.4}[self.throttle]
            return super()._ping_m()

    procedure, _, _ = measure(Louder(TRUE), plan(throttles=(0.0, 0.4, 0.7)))
    assert procedure.measured is not None
    file = procedure.measured.file

    assert file.throttle.share == pytest.approx((1.0, 1.0, 0.5), abs=0.08)
    # What is believed is believed of the loudest.
    assert file.belief().heard.at(2.0) == pytest.approx(
        file.throttle.share[2] * file.heard.least[1], abs=0.05
    )


def test_an_echo_of_something_else_is_late_and_said() -> None:
    class Walled(Hung):
        def _ping_m(self) -> float:
            found = super()._ping_m()
            return 5.5 + self.chance.gauss(0.0, 0.01) if found > 7.65 else found

    procedure, result, _ = measure(Walled(TRUE), plan())
    assert procedure.measured is not None

    assert procedure.measured.file.late_share[0] > 0.2
    assert procedure.measured.file.wild_share[1] < 0.2
    assert "something else echoes steadily" in result.notes[0]


def test_nothing_heard_is_said() -> None:
    with pytest.raises(EchowingError, match="hardly heard at any distance"):
        measure(Hung(replace(TRUE, foil_m=0.1)), plan(seconds=2.0))


def test_broken_off_it_says_that_nothing_was_measured() -> None:
    procedure = ResponseMatrix(plan(), BASE)

    procedure.readings.append(Readings(2.0, 0.0, 0.4, [[1.8, None]]))

    result = procedure.result()
    assert result.checks[0].found == "nothing was measured"
    # What was read until then is kept.
    assert result.measured["readings"][0]["raw_m"] == [[1.8, None]]


def test_a_fixed_mount_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    board = Hung(TRUE)
    fixed = {**board.parameters(), "PAN_US_DEG": 0.0}
    monkeypatch.setattr(board, "parameters", lambda: fixed)
    result = done(ResponseMatrix(plan(), BASE), board)

    assert "a fixed mount" in str(result.incomplete)


@pytest.mark.parametrize("text", ["1;2", "2,1", "1,1", "0.1,1", "1,9"])
def test_numbers_that_make_no_sense_are_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError):
        numbers(text, "metres", 0.5, 8.0)


def test_the_hover_is_one_of_the_throttles() -> None:
    args = Namespace(throttles=[0.0, 0.4], hover=0.5)
    with pytest.raises(EchowingError, match=r"--hover 0\.5: one of --throttles"):
        run(args)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--write", "/dev/null/none/mine.toml"], "--write /dev/null/none: cannot be written"),
        (["--base", "mb1202-fixed"], "--base mb1202-fixed: its sensor is fixed to the nose"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_measured(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["rig", "response-matrix", "--port", "none", *options]) == 2

    told = capsys.readouterr().err
    assert says in told
    assert told.count("\n") == 1


# ---- what a slot takes ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"noise_m": 0.08}, "scatter by 0.08 m"),
        ({"wrong_share": 0.2}, "20% of its readings may be wrong"),
        ({"heard_to_m": 3.0}, "certain to be heard up to 3.2 m"),
        ({"heard": Curve((0.2, 4.0), (0.3, 0.3))}, "as few as 30%"),
        ({"narrowest_rad": Curve((1.0,), (math.radians(4.0),))}, "as narrow as 4 degrees"),
    ],
)
def test_each_thing_that_a_slot_takes_is_asked_for(change: dict[str, Any], says: str) -> None:
    usual = shipped_sonar()
    assert usual.objection(3.0) is None

    assert says in str(replace(usual, **change).objection(3.0))


def test_a_slot_too_near_to_measure_is_refused() -> None:
    assert "does not measure" in str(shipped_sonar().objection(1.0))


def test_the_nearest_slot_that_is_carried() -> None:
    stock = load_sonar("mb1202").belief("stock")
    limits_m = (1.5, 6.0)

    assert shipped_sonar().nearest_carried_m(3.0, limits_m) == pytest.approx(3.0)
    assert stock.objection(3.0) is not None
    assert stock.nearest_carried_m(3.0, limits_m) == pytest.approx(2.3)
    assert deaf(stock).nearest_carried_m(3.0, limits_m) is None


def deaf(sonar: SonarBelief) -> SonarBelief:
    return replace(sonar, heard=Curve((0.2, 4.0), (0.1, 0.1)))


def test_readings_know_what_is_the_leaders() -> None:
    one = Readings(3.0, 0.0, 0.4, [[2.8, None, 2.85, 5.0], [5.05, 5.04, 2.2]])

    assert (one.pings, one.heard, one.elsewhere, one.steady) == (7, 2, 4, 1)
    assert one.hits() == [[True, False, True, False], [False, False, False]]


def test_a_measured_file_is_written_and_read_again(tmp_path: Path) -> None:
    from echowing.sonar_file import write_sonar  # noqa: PLC0415

    readings = [
        Readings(2.0, off_deg, 0.4, [[1.8] * heard + [None] * (40 - heard)])
        for off_deg, heard in ((0.0, 38), (8.0, 36), (16.0, 10))
    ]
    file = measured_sonar(readings, BASE, Conditions("stock", 0.4, 2.0)).file
    write_sonar(tmp_path / "mine.toml", file)

    assert load_sonar(tmp_path / "mine.toml") == file
    assert json.dumps(file.model_dump(mode="json"))
    with pytest.raises(EchowingError, match="cannot be written"):
        write_sonar(tmp_path / "none" / "mine.toml", file)
