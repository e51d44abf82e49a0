"""A fault of `follow` brought again from its log: what came in, when it ticked, which keys.

The .tlog of a flight holds every frame that the session took. `follow-….-fault.json` beside it,
written when the tool fails, holds the rest. `fly_again` takes a new session through the same.
"""

import json
import struct
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.mavlink.messages import TOOL_SYSTEM_ID

_STAMP_BYTES = 8

Call = tuple[float, Callable[[float], object]]


class History:
    """When the session of a flight ticked, and which keys were pressed.

    start_unix_s: UTC at the moment from which the tool counts.
    """

    def __init__(self, start_unix_s: float) -> None:
        self._start_unix_s = start_unix_s
        self._ticks_s: list[float] = []
        self._keys: list[tuple[float, str]] = []

    def ticked(self, now_s: float) -> None:
        """The session is about to tick: twenty times a second at most."""
        self._ticks_s.append(now_s)

    def pressed(self, keys: bytes, now_s: float) -> None:
        """Keys have been pressed, or none."""
        if keys:
            self._keys.append((now_s, keys.hex()))

    def text(self, error: Exception, now_s: float) -> str:
        """What to write down of a fault."""
        trace = traceback.format_exception(error)
        return json.dumps(
            {
                "error": repr(error),
                "start_unix_s": self._start_unix_s,
                "time_s": now_s,
                "traceback": "".join(trace).splitlines(),
                "keys": self._keys,
                "ticks_s": self._ticks_s,
            },
            indent=1,
        )


def fly_again(
    folder: Path,
    receive: Callable[[Any, float], object],
    tick: Callable[[float], object],
    press: Callable[[bytes, float], object] = lambda keys, now_s: None,
) -> None:
    """Do at the same times what a flight did that ended by a fault; the fault is raised again.

    folder: the log's; what is called: of a new session made with the same options.
    """
    (fault,) = folder.glob("follow-*-fault.json")
    told = json.loads(fault.read_text(encoding="utf-8"))
    tlog = fault.with_name(fault.name.replace("-fault.json", ".tlog"))
    start_unix_s = float(told["start_unix_s"])
    calls: list[Call] = [(at_s, tick) for at_s in told["ticks_s"]]
    calls += [
        (unix_s - start_unix_s, partial(receive, message)) for unix_s, message in received(tlog)
    ]
    calls += [(at_s, partial(press, bytes.fromhex(keys))) for at_s, keys in told["keys"]]
    for at_s, call in sorted(calls, key=lambda one: one[0]):
        call(at_s)


def received(tlog: Path) -> Iterator[tuple[float, Any]]:
    """The messages of the vehicles in a .tlog of `follow`, with their UTC times in seconds."""
    data, parser, start = tlog.read_bytes(), mavlink.MAVLink(None), 0
    parser.robust_parsing = True
    while start < len(data):
        (stamp_us,) = struct.unpack_from(">Q", data, start)
        start += _STAMP_BYTES
        message = None
        while message is None and start < len(data):
            message = parser.parse_char(data[start : start + 1])
            start += 1
        if message is not None and message.get_srcSystem() != TOOL_SYSTEM_ID:
            yield stamp_us / 1e6, message
