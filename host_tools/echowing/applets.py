"""The applets for the SD card, what each needs of an autopilot, and which one a vehicle runs."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

Version = tuple[int, int]
"""Of ArduCopter: (4, 8)."""


@dataclass(frozen=True, slots=True)
class Applet:
    """One applet."""

    name: str
    """As the user calls it: `--applet`."""
    file: str
    heaps: tuple[tuple[Version, int], ...]
    """From which ArduCopter on it loads and flies in so many bytes of scripting's memory
    (`SCR_HEAP_SIZE`), newest first: tests/lua/test_heap.py runs it there. Older ones fill more of
    that memory by themselves."""
    source: Path | None = field(default=None, compare=False)
    """Its file in a release; none: the one that comes with this package."""

    def needs_bytes(self, version: Version | None) -> int:
        """Of scripting's memory; None: a version that is not known counts as a new one."""
        if version is None:
            return self.heaps[0][1]
        return next((need for since, need in self.heaps if version >= since), self.heaps[-1][1])

    def fits_since(self, heap_bytes: int) -> Version | None:
        """The oldest ArduCopter with which it loads in so much; None: it never does."""
        return min((since for since, need in self.heaps if need <= heap_bytes), default=None)


# With a margin to the 100 KiB of an F765 from 4.6 on, and from 4.7 on to the 43 KiB of an F427.
HOLD = Applet(
    "hold", "echowing.lua", (((4, 7), 90 * 1024), ((4, 6), 94 * 1024), ((4, 5), 110 * 1024))
)
SPEED = Applet(
    "speed", "echowing_speed.lua", (((4, 7), 40 * 1024), ((4, 6), 47 * 1024), ((4, 5), 63 * 1024))
)
APPLETS = (HOLD, SPEED)

# The parameters that tell which applet runs. Before there were two, one
# applet had all of them but the first.
FORMAT, LAW, GAIN = IDENTIFYING = ("ECHO_FORMAT", "ECHO_LAW", "ECHO_GAIN_P")


def applet_named(name: str) -> Applet:
    """The applet that the user calls so."""
    return next(applet for applet in APPLETS if applet.name == name)


def identify(parameters: Mapping[str, float]) -> Applet | None:
    """Which applet a vehicle with these parameters runs; None: none, or one of another version."""
    from echowing.mavlink.messages import POINT_FORMAT  # noqa: PLC0415 (not for --help)

    if FORMAT in parameters:
        return HOLD if parameters[FORMAT] == POINT_FORMAT else None
    return SPEED if LAW in parameters and GAIN not in parameters else None


def is_outdated(parameters: Mapping[str, float]) -> bool:
    """Whether a vehicle with these parameters runs an applet of another version."""
    return (FORMAT in parameters or LAW in parameters) and identify(parameters) is None


def applets_among(files: Iterable[str]) -> list[Applet]:
    """The applets among the files of a folder; a card's names have no case."""
    names = {file.lower() for file in files}
    return [applet for applet in APPLETS if applet.file in names]
