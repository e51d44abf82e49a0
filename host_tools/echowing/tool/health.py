"""Battery, GPS, clock and switch of each vehicle, in lines under the table of followers."""

from collections.abc import Sequence

from rich.text import Text

from echowing.flight.engage import LEAST_BATTERY_PERCENT
from echowing.tool.panel import NO_MODE, Health, Row

WRONG, UNKNOWN = "bold red", "yellow"


def health(rows: Sequence[Row]) -> Text:
    """A line per vehicle, the leader first; what is wrong stands out."""
    leader = leaders_health(rows[0])
    lines = [_line("leader", leader)]
    lines += [_line(str(row.system_id), its_health(row)) for row in rows]
    return Text("\n").join(lines)


def leaders_health(row: Row) -> Health:
    """The leader's, which all rows share."""
    return Health(
        mode=row.leader_mode or NO_MODE,
        altitude_m=row.leader_altitude_m,
        gps=row.leader_gps,
        battery_percent=row.leader_battery_percent,
        battery_v=row.leader_battery_v,
        clock_s=row.leader_clock_s,
        switch=row.leader_switch,
    )


def its_health(row: Row) -> Health:
    """A follower's; its mode and height are in the table."""
    return Health(
        gps=row.gps,
        battery_percent=row.battery_percent,
        battery_v=row.battery_v,
        clock_s=row.clock_s,
        switch=row.switch,
    )


def in_words(one: Health) -> list[tuple[str, str]]:
    """Each part of a vehicle's health, and its style: empty where all is well."""
    parts = [] if one.mode is None else [(one.mode, "")]
    if one.mode is not None:
        height = "height not known" if one.altitude_m is None else f"{one.altitude_m:.1f} m up"
        parts.append((height, ""))
    parts.append(_gps(one.gps))
    parts.append(_battery(one))
    parts.append(("clock not known", WRONG) if one.clock_s is None else _clock(one.clock_s))
    if one.switch is not None:
        parts.append((f"switch {one.switch}", "" if one.switch == "off" else WRONG))
    return parts


def _line(name: str, one: Health) -> Text:
    line = Text(f"{name}: ")
    for number, (text, style) in enumerate(in_words(one)):
        line.append(", " if number else "")
        line.append(text, style=style or None)
    return line


def _gps(gps: str | None) -> tuple[str, str]:
    if gps is None:
        return "GPS not known", UNKNOWN
    return f"GPS {gps}", "" if gps.startswith("3D") else WRONG


def _clock(round_trip_s: float) -> tuple[str, str]:
    return f"clock {round_trip_s:.2f} s", ""


def _battery(one: Health) -> tuple[str, str]:
    numbers = [
        *([] if one.battery_percent is None else [f"{one.battery_percent:.0f} %"]),
        *([] if one.battery_v is None else [f"{one.battery_v:.1f} V"]),
    ]
    if not numbers:
        return "battery not known", UNKNOWN
    low = one.battery_percent is not None and one.battery_percent < LEAST_BATTERY_PERCENT
    return f"battery {' '.join(numbers)}", WRONG if low else ""
