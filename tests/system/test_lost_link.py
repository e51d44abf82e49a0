"""A follower that has lost its radio goes on looking at its leader, by its applet alone."""

import math
from pathlib import Path

import pytest

from echowing.sim.flight import FormationFlight
from echowing.sim.scenario import load_scenario

from ..world import CLEARLY

pytestmark = pytest.mark.seconds(16)

# The leader comes at its follower and flies off aside; nobody tells the follower.
SCENARIO = """
title = "Lost"
duration_s = 58.0
fault = [{ kind = "outage", vehicle = 2, at_s = 45.0, for_s = 60.0 }]

[leader]
path = "script"

[[leader.script]]
at_s = 5.0
act = "goto"
label = "north"
point_ned_m = [60.0, 0.0, -10.0]
speed_mps = 2.0

[[leader.script]]
at_s = 38.0
act = "hold"
label = "rests"

[[leader.script]]
at_s = 46.0
act = "at_follower"
label = "comes"
speed_mps = 1.0

[[leader.script]]
at_s = 52.0
act = "fly"
label = "leaves"
velocity_ned_mps = [0.7, 0.7, 0.0]
"""
SILENT_S = 46.5  # the co-processor takes the applet's orders a second after the ground tool's last
REACH_M = 4.0


def test_the_leader_is_heard_on_and_kept_away_from(tmp_path: Path) -> None:
    """Heard 0.92 of the time after it (forty seeds, 0.61 to 1); without the applet's orders 0.72.

    A flight of it differs from the next by 0.1, so three of them by 0.06: the share that is asked
    is midway between the two.
    """
    file = tmp_path / "lost.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    ages_ms = [age_ms for seed in (1, 2, 3) for age_ms in flown_ms(file, seed)]
    assert sum(age_ms < 300.0 for age_ms in ages_ms) > 0.82 * len(ages_ms)


def flown_ms(file: Path, seed: int) -> list[float]:
    """How old the last echo is, at each moment near the leader after the link is lost."""
    flight = FormationFlight(load_scenario(str(file), CLEARLY), seed)
    (follower,) = flight.followers
    ages_ms: list[float] = []

    def look() -> None:
        script = follower.autopilot.script
        assert script is not None
        track, own = script.local_value("track"), script.local_value("own")
        apart_m = math.dist(flight.leader.position_ned_m, follower.position_ned_m)
        if flight.t_s > SILENT_S and apart_m < REACH_M:
            ages_ms.append(own.at_ms - track.seen_ms)

    result = flight.run(after_step=look)

    assert result.closest_m > 1.5
    return ages_ms
