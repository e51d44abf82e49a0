"""The README's picture of the live table: `python -m echowing.docs.live_table FILE.svg`.

The real tool leads two simulated vehicles behind a third, in real time. The picture is what its
view shows once both are in their slots.
"""

import contextlib
import io
import math
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from echowing.flight.guard import FIELD_LIMITS
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.mavlink.links import parse_address
from echowing.mavlink.seats import Seat
from echowing.sonar_file import shipped_sonar
from echowing.stopping import StopRequest
from echowing.tool.panel import FOLLOWING, Row
from echowing.tool.run import FollowOptions, FollowTool
from echowing.tool.view import scene

PORT = 5760  # as in the README
WIDTH_CHARACTERS = 80
EVENTS_SHOWN = 8
IN_PLACE_M = 0.6
# Both must be in place this long, so that the link quality is known and the lines have settled.
SETTLED_S = 8.0
LONGEST_S = 120.0
# Nearer than receivers demand: the built-in simulator's are good enough for a picture.
SLOTS = [Slot(3.0), Slot(5.0, math.radians(50.0))]
WORLD = (
    *("echowing", "--set", "leader.speed_mps=1.5"),
    *("--set", "formation.slots=[{radius_m=3.0},{radius_m=5.0, angle_deg=50.0}]"),
    *("--set", "formation.slot_separation_m=3.5"),
)


class Photographer:
    """A view that keeps its rows and events when all are in place, and then asks for the end."""

    def __init__(self, stop: StopRequest) -> None:
        self._stop = stop
        self._since_s: float | None = None
        self.events: list[str] = []
        self.taken: Sequence[Row] = ()

    def event(self, time_s: float, text: str) -> None:
        """As `View`."""
        if not self.taken:
            self.events = [*self.events, f"{time_s:7.1f} s  {text}"][-EVENTS_SHOWN:]

    def rows(self, time_s: float, rows: Sequence[Row]) -> None:
        """As `View`."""
        if not all(map(_in_place, rows)):
            self._since_s = None
        elif self._since_s is None:
            self._since_s = time_s
        elif time_s - self._since_s >= SETTLED_S and not self.taken:
            self.taken = list(rows)
            self._stop.count += 1

    def keys(self, text: str) -> None:
        """As `View`; there are none."""

    def close(self) -> None:
        """As `View`."""


def _in_place(row: Row) -> bool:
    near = row.error_m is not None and abs(row.error_m) < IN_PLACE_M
    return near and row.state.startswith(FOLLOWING) and row.command_mps is not None


def photograph() -> Photographer:
    """Fly, and return what was seen. Raises TimeoutError if they never were in place."""
    stop = StopRequest()
    photographer = Photographer(stop)
    with _served():
        FollowTool(_options(), photographer, stop).run()
    if not photographer.taken:
        raise TimeoutError(f"not in place within {LONGEST_S:g} s; it said: {photographer.events}")
    return photographer


def _options() -> FollowOptions:
    roles = ("leader", "follower", "follower")
    return FollowOptions(
        seats=[
            Seat(role, parse_address(f"tcp:127.0.0.1:{PORT + 10 * number}"), number + 1)
            for number, role in enumerate(roles)
        ],
        slots=SLOTS,
        settings=GuidanceSettings(),
        sonar=shipped_sonar(),
        altitude_m=None,
        limits=FIELD_LIMITS,
        engage=True,
        duration_s=LONGEST_S,
    )


@contextlib.contextmanager
def _served() -> Iterator[None]:
    command = [sys.executable, "-m", "echowing", "sim", *WORLD, "--serve", str(PORT)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as world:
        try:
            assert world.stdout is not None
            for line in world.stdout:
                if "system 3" in line:
                    break
            yield
        finally:
            world.terminate()


def drawn(rows: Sequence[Row], events: Sequence[str]) -> str:
    """The view as an SVG, without fonts of other servers and without local file names."""
    console = Console(
        record=True,
        width=WIDTH_CHARACTERS,
        file=io.StringIO(),
        force_terminal=True,
        _environ={},  # the same picture whatever terminal this runs in
    )
    console.print(scene(rows, events))
    svg = console.export_svg(title="echowing follow", unique_id="follow")
    without_fonts = re.sub(r"\s*@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    return re.sub(r"[ \t]+$", "", without_fonts, flags=re.MULTILINE)


def main(path: Path) -> None:
    """Fly and write the picture."""
    seen = photograph()
    path.write_text(drawn(seen.taken, seen.events), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
