"""`echowing setup`: which board carries which applet, and how much memory it is told to give."""

from typing import Any

import pytest

from echowing.applets import HOLD, SPEED, Applet, applets_among, identify, is_outdated
from echowing.mavlink.messages import POINT_FORMAT
from echowing.setup.apply import changes_for, hidden_for
from echowing.setup.boards import board_of
from echowing.setup.checks import Finding, Verdict, examine, memory
from echowing.setup.readout import CardApplet, Readout
from echowing.setup.settings import HEAP
from echowing.setup.view import differences

# ArduPilot's board ids, and how much their boards give to scripts.
CUBE_ORANGE, PIXHAWK_4, CUBE_BLACK, MATEK_F405, NEW_BOARD, SITL = 140, 50, 9, 125, 65_000, 0
H7_BYTES, F7_BYTES, F4_BYTES = 204_800, 102_400, 44_032
SMALL, LARGE = SPEED, HOLD


def new_vehicle(board_id: int | None, heap_bytes: float | None, **rest: Any) -> Readout:
    """Its applet does not run yet."""
    parameters = {"SCR_ENABLE": 1.0} | ({} if heap_bytes is None else {HEAP: float(heap_bytes)})
    return Readout(parameters, board_id=board_id, applet_on_card=CardApplet.NONE, **rest)


def written(readout: Readout) -> float | None:
    return next((one.new for one in changes_for(readout) if one.name == HEAP), None)


@pytest.mark.parametrize(
    ("board_id", "gives_bytes"),
    [
        (CUBE_ORANGE, H7_BYTES),
        (53, H7_BYTES),  # Pixhawk 6X
        (1063, H7_BYTES),  # Cube Orange+
        (PIXHAWK_4, F7_BYTES),
        (120, F7_BYTES),  # Cube Yellow
        (CUBE_BLACK, F4_BYTES),
        (MATEK_F405, 0),
        (121, 0),  # OMNIBUSF7V2: an F745 with 1 MB of flash
    ],
)
def test_a_board_gives_what_ardupilot_gives_it(board_id: int, gives_bytes: int) -> None:
    board = board_of(board_id)
    assert board is not None
    assert board.heap_bytes == gives_bytes


@pytest.mark.parametrize("unknown", [None, SITL, NEW_BOARD])
def test_a_board_that_is_not_in_the_table_is_not_known(unknown: int | None) -> None:
    assert board_of(unknown) is None


@pytest.mark.parametrize(
    ("board_id", "had_bytes", "gets_bytes"),
    [
        (CUBE_ORANGE, H7_BYTES, None),
        (CUBE_ORANGE, 20_000, H7_BYTES),
        (CUBE_ORANGE, 307_200, None),  # the pilot's, for other scripts
        (CUBE_BLACK, F4_BYTES, None),
        (CUBE_BLACK, 204_800, F4_BYTES),  # what `apply` once wrote there: it leaves no heap
        (CUBE_BLACK, 60_000, None),
        (CUBE_BLACK, 20_000, F4_BYTES),
        (PIXHAWK_4, 20_000, F7_BYTES),
        (PIXHAWK_4, 1_048_576, F7_BYTES),
    ],
)
def test_the_small_applet_gets_what_its_board_can_give(
    board_id: int, had_bytes: int, gets_bytes: int | None
) -> None:
    readout = new_vehicle(board_id, had_bytes, applet=SMALL)
    assert written(readout) == gets_bytes
    assert memory(readout).verdict is Verdict.FINE


def test_no_board_is_told_to_give_more_than_it_gives_by_itself() -> None:
    for board_id in range(7000):
        board = board_of(board_id)
        for applet in (LARGE, SMALL):
            told = written(new_vehicle(board_id, 1024, applet=applet))
            assert told is None or (board is not None and told == board.heap_bytes)


@pytest.mark.parametrize(
    ("board_id", "has", "fix"),
    [
        (CUBE_BLACK, "Pixhawk 1 / Cube Black (F427) has 43 KiB for scripts", "--applet speed"),
        (MATEK_F405, "MatekF405 (F405) has no scripting", "an autopilot with"),
    ],
)
@pytest.mark.parametrize("heap_bytes", [None, F4_BYTES, 204_800])
def test_a_board_that_is_too_small_is_refused(
    board_id: int, has: str, fix: str, heap_bytes: int | None
) -> None:
    readout = new_vehicle(board_id, heap_bytes, applet=LARGE)
    finding = memory(readout)
    assert (finding.verdict, finding.found) == (Verdict.WRONG, has)
    assert "echowing.lua needs 90 KiB: it does not load" in finding.why
    assert fix in finding.fix
    assert finding in examine(readout)
    assert written(readout) is None
    assert HEAP not in hidden_for(readout)


@pytest.mark.parametrize(
    ("version", "applet", "needs"),
    [
        ((4, 6), SMALL, "echowing_speed.lua needs 47 KiB"),
        ((4, 6), LARGE, "echowing.lua needs 94 KiB"),
        ((4, 5), SMALL, "echowing_speed.lua needs 63 KiB"),
        ((4, 5), LARGE, "echowing.lua needs 110 KiB"),
    ],
)
def test_up_to_4_6_an_f427_carries_no_applet(
    version: tuple[int, int], applet: Applet, needs: str
) -> None:
    """ArduCopter fills 6 kB of the scripts' memory by itself there, 4.5 even 22 kB."""
    readout = new_vehicle(CUBE_BLACK, F4_BYTES, applet=applet, version=version)
    finding = memory(readout)
    assert (finding.verdict, finding.why) == (Verdict.WRONG, f"{needs}: it does not load")
    assert finding.fix == "--applet speed fits there with ArduCopter 4.7 or later"
    assert written(readout) is None


def test_a_pilot_has_found_the_room_that_4_6_needs() -> None:
    readout = new_vehicle(CUBE_BLACK, 48 * 1024, applet=SMALL, version=(4, 6))
    assert memory(readout).verdict is Verdict.FINE


def test_with_4_5_an_f765_carries_the_small_applet_alone() -> None:
    large = new_vehicle(PIXHAWK_4, F7_BYTES, applet=LARGE, version=(4, 5))
    finding = memory(large)
    assert finding.verdict is Verdict.WRONG
    assert finding.why == "echowing.lua needs 110 KiB: it does not load"
    assert finding.fix == (
        "--applet speed fits there; --applet hold fits there with ArduCopter 4.6 or later"
    )
    assert written(large) is None
    for applet, version in ((SMALL, (4, 5)), (LARGE, (4, 6))):
        readout = new_vehicle(PIXHAWK_4, F7_BYTES, applet=applet, version=version)
        assert memory(readout).verdict is Verdict.FINE


@pytest.mark.parametrize("version", [(4, 7), (4, 8), None])
def test_from_4_7_on_an_f427_carries_the_small_applet(version: tuple[int, int] | None) -> None:
    readout = new_vehicle(CUBE_BLACK, F4_BYTES, applet=SMALL, version=version)
    assert memory(readout).verdict is Verdict.FINE


@pytest.mark.parametrize(
    ("version", "tries"), [((4, 5), 64_512), ((4, 6), 48_128), ((4, 8), 40_960)]
)
def test_of_an_unknown_board_it_is_told_what_its_version_needs(
    version: tuple[int, int], tries: int
) -> None:
    finding = memory(new_vehicle(NEW_BOARD, 20_000, applet=SMALL, version=version))
    assert f"try SCR_HEAP_SIZE {tries} " in finding.fix


def test_an_applet_that_runs_has_memory_enough() -> None:
    """A pilot has found more room on his board than it gives by itself."""
    running = {"ECHO_FORMAT": POINT_FORMAT, "ECHO_ENABLE": 1.0, HEAP: 100_000.0}
    for board_id in (CUBE_BLACK, NEW_BOARD, SITL):
        assert memory(Readout(running, board_id=board_id)).verdict is Verdict.FINE
    assert memory(new_vehicle(CUBE_BLACK, LARGE.needs_bytes(None) // 2)).verdict is Verdict.WRONG


@pytest.mark.parametrize(
    ("heap_bytes", "verdict"),
    [(None, Verdict.UNKNOWN), (204_800, Verdict.UNKNOWN), (F4_BYTES, Verdict.WRONG)],
)
def test_of_an_unknown_board_its_own_value_stays(heap_bytes: int | None, verdict: Verdict) -> None:
    readout = new_vehicle(NEW_BOARD, heap_bytes, applet=LARGE)
    finding = memory(readout)
    assert finding.verdict is verdict
    assert "board 65000 is not known" in finding.why
    assert "SCR_DEBUG_OPTS 2" in finding.fix
    assert written(readout) is None
    assert HEAP not in hidden_for(readout)
    told = "\n".join(differences(readout, [], {}))
    assert "left alone: echowing.lua needs" in told


# ---- which applet -----------------------------------------------------------------------------

OLD = {"ECHO_ENABLE": 1.0, "ECHO_LAW": 2.0, "ECHO_GAIN_P": 0.7}  # before there were two


@pytest.mark.parametrize(
    ("parameters", "applet", "outdated"),
    [
        ({"ECHO_FORMAT": POINT_FORMAT, "ECHO_ENABLE": 1.0}, HOLD, False),
        ({"ECHO_LAW": 0.0, "ECHO_ENABLE": 1.0}, SPEED, False),
        (OLD, None, True),
        # Its law is one that the speed applet has, too: only the gain tells.
        ({"ECHO_LAW": 0.0, "ECHO_GAIN_P": 0.7}, None, True),
        ({"ECHO_GAIN_P": 0.7}, None, False),
        ({"ECHO_FORMAT": POINT_FORMAT + 1.0}, None, True),
        ({}, None, False),
    ],
)
def test_an_applet_is_known_by_its_parameters(
    parameters: dict[str, float], applet: object, outdated: bool
) -> None:
    assert identify(parameters) is applet
    assert is_outdated(parameters) is outdated


def finding_about(readout: Readout, about: str) -> Finding:
    return next(one for one in examine(readout) if one.about == about)


def test_an_applet_of_another_version_is_to_be_updated() -> None:
    found = finding_about(Readout(OLD), "applet")
    assert found.verdict is Verdict.WRONG
    assert "update it: echowing setup lua" in found.fix


@pytest.mark.parametrize("card", [CardApplet.SEVERAL, CardApplet.OTHER])
def test_a_second_applet_on_the_card_is_told(card: CardApplet) -> None:
    found = finding_about(Readout({}, applet_on_card=card), "applet on the card")
    assert found.verdict is Verdict.WRONG
    assert "--applet hold --replace" in found.fix


def test_a_card_has_no_case() -> None:
    assert applets_among(["ECHOWING.LUA", "other.lua", "echowing.lua.new"]) == [HOLD]
    assert applets_among(["echowing_speed.lua", "echowing.lua"]) == [HOLD, SPEED]
