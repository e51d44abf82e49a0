"""Battery, GPS, clock and switch of each vehicle, in lines under the table of followers."""

from collections.abc import Sequence

from rich.text import Text

from echowing.flight.engage import LEAST_BATTERY_PERCENT
from echowing.tool.panel import Row, VehicleHealth

WRONG, UNKNOWN = "bold red", "yellow"


def health(rows: Sequence[Row]) -> Text:
    """A line per vehicle, the leader first; wrong values are highlighted."""
    lines = [_line("leader", leaders_words(rows[0].leader))]
    lines += [_line(str(row.system_id), [*in_words(row.own), *_sonar(row)]) for row in rows]
    return Text("\n").join(lines)


def leaders_words(one: VehicleHealth) -> list[tuple[str, str]]:
    """The leader's health, with its mode and height, which no table shows."""
    height = "height not known" if one.altitude_m is None else f"{one.altitude_m:.1f} m up"
    return [(one.mode or "mode not known", ""), (height, ""), *in_words(one)]


def in_words(one: VehicleHealth) -> list[tuple[str, str]]:
    """A follower's health without mode and height: each part with its style; empty: all is well."""
    parts = [_gps(one.gps), _battery(one)]
    parts.append(("clock not known", WRONG) if one.clock_s is None else _clock(one.clock_s))
    if one.switch is not None:
        parts.append((f"switch {one.switch}", "" if one.switch == "off" else WRONG))
    return parts


def _sonar(row: Row) -> list[tuple[str, str]]:
    """What its sonar has heard in the last minute; what is worse than believed in full."""
    if row.worse is not None:
        return [(row.worse, WRONG)]
    words = []
    if row.heard_percent is not None:
        words.append(f"hears {row.heard_percent:.0f} %")
    if row.scatter_m is not None:
        words.append(f"± {100.0 * row.scatter_m:.0f} cm")
    if row.wrong_percent is not None:
        words.append(f"{row.wrong_percent:.0f} % wrong")
    return [(" ".join(words), "")] if words else []


def _line(name: str, words: Sequence[tuple[str, str]]) -> Text:
    line = Text(f"{name}: ")
    for number, (text, style) in enumerate(words):
        line.append(", " if number else "")
        line.append(text, style=style or None)
    return line


def _gps(gps: str | None) -> tuple[str, str]:
    if gps is None:
        return "GPS not known", UNKNOWN
    return f"GPS {gps}", "" if gps.startswith("3D") else WRONG


def _clock(round_trip_s: float) -> tuple[str, str]:
    return f"clock {round_trip_s:.2f} s", ""


def _battery(one: VehicleHealth) -> tuple[str, str]:
    numbers = [
        *([] if one.battery_percent is None else [f"{one.battery_percent:.0f} %"]),
        *([] if one.battery_v is None else [f"{one.battery_v:.1f} V"]),
    ]
    if not numbers:
        return "battery not known", UNKNOWN
    low = one.battery_percent is not None and one.battery_percent < LEAST_BATTERY_PERCENT
    return f"battery {' '.join(numbers)}", WRONG if low else ""
