"""`echowing rig self-test`: the board tests itself; what failed is told with what to do."""

import argparse
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from rich.console import Console
from rich.table import Table

from echowing.errors import EchowingError
from echowing.rig.board import COMMAND_SELF_TEST, Board, open_board
from echowing.rig.options import print_json

EXAMPLES = """\
examples:
  echowing rig self-test
  echowing rig self-test --yes --json
      asks nothing, and assumes that the servos swept
Exit code 1 when a part has failed.
"""

PREFIX = "Echowing test: "
ENDED = "Echowing test: ended"
# The test takes 2.5 s (firmware/README.md); memory that is being written delays its end.
TIMEOUT_S = 10.0

FINE, FAILED, UNTESTED = "fine", "failed", "not tested"
QUESTION = "Did both servos sweep left, right, down, up, and come back? [y/n] "


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the board and how it stands."""

    name: str
    verdict: str
    remedy: str = ""


# A part, what its text begins with, what makes it fine, what makes it untested; and what to do.
_PARTS = (
    (
        "sonar",
        "sonar ",
        "good",
        None,
        "check its 5 V behind R1, SDA and SCL for being swapped or open, and its address "
        "(SONAR_ADDR, as delivered 112); 3.3 V boards: the bus's level shifter has 3.3 V and V+",
    ),
    (
        "memory",
        "memory ",
        "good",
        None,
        "change a parameter (`echowing rig params set`), wait until it is stored and test again; "
        "if it fails again the board's memory is worn out: the board goes on with its defaults",
    ),
    (
        "autopilot port",
        "autopilot port ",
        "good",
        "no loop plug",
        "join its two data lines with a plug to test it",
    ),
    (
        "USB port",
        "USB port ",
        "good",
        "no loop plug",
        "a board that answers over USB needs no plug there",
    ),
)
_SERVOS = (
    "check the servos' own 5 V and the common ground, then each signal wire against the table in "
    "firmware/README.md; one way round only: PAN_US_DEG, TILT_US_DEG"
)
_NOT_TOLD = "the board has not reported it; run the test again"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--yes", action="store_true", help="do not ask whether the servos swept; they did"
    )


def run(args: argparse.Namespace) -> int:
    """Test, ask, print; 1 when a part has failed."""
    console = Console(stderr=args.json)
    with open_board(args.port, args.baud) as board:
        console.print("the servos go left, right, down, up and back: watch them", highlight=False)
        texts = hear_test(board)
    parts = [*judged(texts), servos(swept=args.yes or ask_swept(console))]
    if args.json:
        print_json({"parts": [asdict(part) for part in parts], "passed": passed(parts)})
    else:
        console.print(table(parts))
    return 0 if passed(parts) else 1


def hear_test(board: Board) -> list[str]:
    """Start the test and listen to its end: what it tells, in order.

    Raises EchowingError when it does not start, or does not end.
    """
    board.poll(0.0)
    before = len(board.state.texts)
    board.command(COMMAND_SELF_TEST)
    deadline_s = board.now_s() + TIMEOUT_S
    while True:
        told = [text for _, _, text in board.texts[before:] if text.startswith(PREFIX)]
        if told and told[-1].startswith(ENDED):
            return told
        if board.now_s() > deadline_s:
            raise EchowingError(
                "the self test has not ended: was the autopilot armed? Disarm it and try again"
            )
        board.poll(0.1)


def judged(texts: Iterable[str]) -> list[Part]:
    """The parts, by what the board has told."""
    told = [text.removeprefix(PREFIX) for text in texts]
    return [_judge(told, *part) for part in _PARTS]


def _judge(
    told: list[str], name: str, begins: str, good: str, untested: str | None, remedy: str
) -> Part:
    text = next((text for text in told if text.startswith(begins)), None)
    if text is None:
        return Part(name, FAILED, _NOT_TOLD)
    if text.endswith(good):
        return Part(name, FINE)
    verdict = UNTESTED if untested is not None and text.endswith(untested) else FAILED
    return Part(name, verdict, f"{text.removeprefix(begins).removeprefix('has ')}: {remedy}")


def servos(*, swept: bool) -> Part:
    """The part that only eyes can judge."""
    return Part("servos", FINE) if swept else Part("servos", FAILED, _SERVOS)


def ask_swept(console: Console) -> bool:
    """Ask whoever stands before the gimbal."""
    console.print(QUESTION, end="", markup=False, highlight=False)
    answer = sys.stdin.readline()
    if not answer:
        raise EchowingError(
            "no answer whether the servos swept; with --yes the question is not asked"
        )
    return answer.strip().lower() in ("y", "yes")


def passed(parts: Iterable[Part]) -> bool:
    """Whether no part has failed."""
    return all(part.verdict != FAILED for part in parts)


def table(parts: Iterable[Part]) -> Table:
    """The parts for people."""
    styles = {FINE: "green", FAILED: "bold red", UNTESTED: "dim"}
    shown = Table(box=None, show_header=False, pad_edge=False)
    for part in parts:
        shown.add_row(part.name, f"[{styles[part.verdict]}]{part.verdict}[/]", part.remedy)
    return shown
