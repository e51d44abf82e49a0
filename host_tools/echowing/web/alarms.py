"""What is wrong at one moment, most serious first, in words for large letters. Pure."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum

from echowing.flight.clocks import UNHEARD_S
from echowing.flight.engage import LEAST_BATTERY_PERCENT
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.health import Health
from echowing.tool.moment import Moment
from echowing.tool.panel import FOLLOWING, GIMBAL, Row
from echowing.tool.track import Track

# README, flight day: abort at a separation under half of the wanted one.
TOO_NEAR_SHARE = 0.5
STALE_S = GuidanceSettings().stale_age_s or 1.0
SONAR_FAULT = GIMBAL[3]


class Level(IntEnum):
    """How serious it is: nothing to do, look, act."""

    GOOD = 0
    LOOK = 1
    ACT = 2


@dataclass(frozen=True, slots=True)
class Alarm:
    """One thing that is wrong; system_id: the vehicle."""

    level: Level
    system_id: int
    text: str


def alarms(moment: Moment) -> list[Alarm]:
    """Everything that is wrong now, most serious first."""
    found = [*_of_leader(moment), *_of_followers(moment.rows, moment.tracks)]
    found += _of_health(moment.health)
    return sorted(found, key=lambda alarm: (-alarm.level, alarm.system_id))


def headline(moment: Moment) -> str:
    """A summary, for when nothing is wrong."""
    followers = len(moment.rows)
    if not any(row.state for row in moment.rows):  # nobody leads them, or it is not known
        return f"{followers} follower" + ("" if followers == 1 else "s")
    following = sum(row.state.startswith(FOLLOWING) for row in moment.rows)
    watched = sum(row.state == "only watched" for row in moment.rows)
    if watched == followers:
        return "Only watching"
    return f"{following} of {followers} following"


def _of_leader(moment: Moment) -> Iterator[Alarm]:
    if not moment.rows:
        return
    row = moment.rows[0]
    if row.leader_age_s is None:
        yield Alarm(Level.ACT, moment.leader_id, "Leader: no report yet")
    elif row.leader_age_s > STALE_S:
        yield Alarm(Level.ACT, moment.leader_id, f"Leader: no report for {row.leader_age_s:.1f} s")
    yield from _of_battery("The leader", moment.leader_id, row.leader.battery_percent)


def _of_followers(rows: Sequence[Row], tracks: Sequence[Track]) -> Iterator[Alarm]:
    for row, track in zip(rows, tracks, strict=True):
        name = f"Follower {row.system_id}"
        yield from _of_state(name, row)
        yield from _of_distance(name, row, track)
        if row.gimbal == SONAR_FAULT:
            yield Alarm(Level.LOOK, row.system_id, f"{name}: its sonar has a fault")
        elif row.worse is not None:
            yield Alarm(Level.LOOK, row.system_id, f"{name}: {row.worse}")
        yield from _of_battery(name, row.system_id, row.own.battery_percent)


def _of_state(name: str, row: Row) -> Iterator[Alarm]:
    if row.age_s is None:
        yield Alarm(Level.ACT, row.system_id, f"{name}: no report yet")
    elif row.age_s > UNHEARD_S:
        yield Alarm(Level.ACT, row.system_id, f"{name}: no report for {row.age_s:.0f} s")
    elif level_of(row) is not Level.GOOD:
        yield Alarm(level_of(row), row.system_id, f"{name}: {row.state}")


def level_of(row: Row) -> Level:
    """How serious a follower's state is; what its pilot does is not wrong."""
    if row.state.startswith(("holding", "not engaged", "gives way")):
        return Level.LOOK
    return Level.ACT if row.state == "no points sent" else Level.GOOD


def _of_distance(name: str, row: Row, track: Track) -> Iterator[Alarm]:
    wanted_m = track.wanted_radius_m
    if row.separation_m is None or row.separation_m >= TOO_NEAR_SHARE * wanted_m:
        return
    watched = "the leader" if row.watches is None else f"follower {row.watches}"
    text = f"{name} is {row.separation_m:.1f} m from {watched} (wanted {wanted_m:.1f} m)"
    yield Alarm(Level.ACT, row.system_id, text)


def _of_battery(name: str, system_id: int, percent: float | None) -> Iterator[Alarm]:
    if percent is not None and percent < LEAST_BATTERY_PERCENT:
        yield Alarm(Level.ACT, system_id, f"{name} has {percent:.0f} % of its battery left")


def _of_health(health: Health) -> Iterator[Alarm]:
    if len(health.lost) == 1:
        yield Alarm(Level.LOOK, health.lost[0], f"Follower {health.lost[0]} sees nobody any more")
    elif health.lost:
        listed = ", ".join(map(str, health.lost))
        yield Alarm(Level.LOOK, health.lost[0], f"Followers {listed} see nobody any more")
