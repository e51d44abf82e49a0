"""The applets for the SD card, and what each needs of an autopilot."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Applet:
    """One applet."""

    name: str
    """As the user calls it: `--applet`."""
    file: str
    heap_bytes: int
    """It loads and flies in so much of scripting's memory (`SCR_HEAP_SIZE`), and may take no more:
    tests/lua/test_heap.py runs it there."""


# 90 KiB is what an F765's 100 KiB leave with a margin, 40 KiB what an F427's 43 KiB leave.
# The hold still carries the speed laws, which will become an applet of their own: 133,376 bytes.
HOLD = Applet("hold", "echowing.lua", 132 * 1024)
SPEED = Applet("speed", "echowing_speed.lua", 40 * 1024)
APPLETS = (HOLD, SPEED)
