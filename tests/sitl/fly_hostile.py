"""Leaders that a follower must survive, and a wall: the least distance in truth."""

import time
from collections.abc import Callable

import pytest

from echowing.geo import displace, ned_between

from . import truth
from .formation import HEIGHT_M, RADIUS_M, Formation, rest
from .names import SPEED
from .plugin import Start
from .sonar import wall
from .table import Entry, Figures
from .vehicle import ORIGIN

LEAST_M = 1.0
SPEED_MPS = 2.0
AWAY_S, BACK_S, AFTER_S = 14.0, 6.0, 8.0
PAST_M = 15.0  # so far beyond its follower's place a leader turns back
WALL_NORTH_M, BEHIND_M = 14.0, 5.0
AT_WALL_S = 30.0
NEAR_M = 4.0  # nearer than this, or the wall was never put to the test


def _away(formation: Formation) -> None:
    formation.leader.fly((SPEED_MPS, 0.0, 0.0))
    rest(AWAY_S)


def _stop(formation: Formation) -> None:
    _away(formation)
    formation.leader.fly((0.0, 0.0, 0.0))
    rest(AFTER_S)


def _back(formation: Formation, speed_mps: float, times: int) -> None:
    for _ in range(times):
        _away(formation)
        formation.leader.fly((-speed_mps, 0.0, 0.0))
        rest(BACK_S)
    formation.leader.fly((0.0, 0.0, 0.0))
    rest(AFTER_S)


def _through(formation: Formation) -> None:
    """Back through the place where its follower is, as a pilot who flies home would."""
    leader, follower = formation.leader, formation.follower
    _away(formation)
    leader.set(SPEED, SPEED_MPS)
    north_m, east_m, _ = ned_between(ORIGIN, follower.state.position)
    leader.go_to(displace(ORIGIN, (north_m - PAST_M, east_m, 0.0)), HEIGHT_M)
    rest(AWAY_S)


MANOEUVRES: dict[str, Callable[[Formation], None]] = {
    "stops": _stop,
    "reverses-1mps": lambda formation: _back(formation, 1.0, 1),
    "reverses-2mps": lambda formation: _back(formation, 2.0, 1),
    "reverses-2mps-twice": lambda formation: _back(formation, 2.0, 2),
    "turns-back-through-it": _through,
}


@pytest.mark.parametrize("seed", [1, 2], ids=["seed1", "seed2"])
@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_leader(start: Start, table: list[Entry], manoeuvre: str, seed: int) -> None:
    formation = start(seed)
    formation.fly_in_formation()
    began_s = time.monotonic()
    MANOEUVRES[manoeuvre](formation)
    ended_s = time.monotonic()
    least_m = formation.least_m(began_s, ended_s)
    note = formation.note(began_s)
    version = formation.kit.version.line
    table.append(Entry(version, f"{manoeuvre}, seed {seed}", Figures(least_m=least_m), note=note))
    assert least_m >= LEAST_M
    flown = formation.measured(began_s, ended_s)
    assert flown.max_separation_m > RADIUS_M  # they moved: nobody was left on the ground


@pytest.mark.parametrize("speed_mps", [1.0, 2.0])
def test_wall(start: Start, table: list[Entry], speed_mps: float) -> None:
    formation = start()
    follower = formation.follower
    formation.followers[0].feeder.scene = wall(WALL_NORTH_M)
    for name in ("ECHO_SPD_INIT", "ECHO_SPD_LOST"):
        follower.set(name, speed_mps)
    follower.arm()
    follower.take_off(HEIGHT_M)
    began_s = time.monotonic()
    behind = displace(ORIGIN, (WALL_NORTH_M + BEHIND_M, 0.0, 0.0))
    follower.go_to(behind, HEIGHT_M, yaw_rad=0.0)
    rest(AT_WALL_S)
    flown = truth.track_ned_m(truth.between(follower.heard.truth, began_s, time.monotonic()))
    least_m = WALL_NORTH_M - float(flown[:, 0].max())
    note = formation.note(began_s)
    version = formation.kit.version.line
    table.append(Entry(version, f"wall, {speed_mps:g} m/s", Figures(least_m=least_m), note=note))
    assert LEAST_M <= least_m < NEAR_M
