"""What a flight sent over its radios: `python -m echowing.analysis.traffic FILE.tlog`.

`follow --log` keeps every frame that it used or sent, so the table is what the links carried of it.
"""

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from echowing.errors import EchowingError
from echowing.mavlink.messages import TOOL_SYSTEM_ID

# A start-up is no flight: what is asked and answered once is left out with it.
SKIPPED_S = 10.0


@dataclass(frozen=True, slots=True)
class Traffic:
    """One kind of message on one way. way: who sends it, and to whom where that is one vehicle."""

    way: str
    message: str
    per_s: float
    bytes_ps: float


def traffic(path: Path, skipped_s: float = SKIPPED_S) -> list[Traffic]:
    """What went over the radios after the first `skipped_s`, the most bytes of each way first.

    Raises EchowingError where the log holds less than a second of it.
    """
    counts: Counter[tuple[str, str]] = Counter()
    sizes: Counter[tuple[str, str]] = Counter()
    begin_s = end_s = 0.0
    for stamp_s, way, name, size in _frames(path):
        begin_s = begin_s or stamp_s + skipped_s
        if stamp_s < begin_s:
            continue
        end_s = stamp_s
        counts[way, name] += 1
        sizes[way, name] += size
    lasts_s = end_s - begin_s
    if lasts_s < 1.0:
        raise EchowingError(f"{path}: holds less than {skipped_s + 1.0:g} s of a flight")
    rows = [
        Traffic(way, name, counts[way, name] / lasts_s, sizes[way, name] / lasts_s)
        for way, name in counts
    ]
    return sorted(rows, key=lambda row: (row.way, -row.bytes_ps))


def _frames(path: Path) -> Iterable[tuple[float, str, str, int]]:
    from pymavlink import mavutil  # noqa: PLC0415 (slow import)

    if not path.is_file():
        raise EchowingError(f"{path}: no such file")
    log = mavutil.mavlink_connection(str(path))
    while (message := log.recv_match()) is not None:
        if message.get_type() == "BAD_DATA":
            continue
        system_id = message.get_srcSystem()
        way = f"from system {system_id}"
        if system_id == TOOL_SYSTEM_ID:
            way = f"to system {getattr(message, 'target_system', 0) or 'all'}"
        yield message._timestamp, way, message.get_type(), len(message.get_msgbuf())


def text(rows: Iterable[Traffic]) -> str:
    """The rows as a Markdown table, each way with its sum."""
    listed = list(rows)
    lines = ["| way | message | per second | bytes per second |", "|---|---|---:|---:|"]
    for way in dict.fromkeys(row.way for row in listed):
        own = [row for row in listed if row.way == way]
        lines += [
            f"| {way} | {row.message} | {row.per_s:.2f} | {row.bytes_ps:.0f} |" for row in own
        ]
        lines.append(f"| **{way}** | **sum** | | **{sum(row.bytes_ps for row in own):.0f}** |")
    return "\n".join(lines)


if __name__ == "__main__":
    try:
        print(text(traffic(Path(sys.argv[1]))))
    except EchowingError as error:
        sys.exit(f"traffic: {error}")
