"""What late echoes do to the readings: the firmware's core under the acoustic model."""

import math
from pathlib import Path

import pytest

from echowing.bench import late_echoes
from echowing.bench.late_echoes import listen_to
from echowing.sim.boards.coprocessor import parameter_table

README = Path(__file__).resolve().parents[2] / "firmware" / "README.md"
DEFAULTS = {row.name: int(row.default) for row in parameter_table()}
PERIOD_MS, JITTER_MS = DEFAULTS["SONAR_PERIOD"], DEFAULTS["SONAR_JITTER"]


def test_at_50_ms_a_wall_behind_the_leader_is_taken_for_a_near_one() -> None:
    row = listen_to(50, 5, leader=True, reflector_m=10.0)
    # Echoes of the ping before: 10 m less the 8.6 m that sound goes there and back in 50 ms.
    assert row.false > 0.8
    assert row.scene == "leader and reflector at 10 m"


@pytest.mark.parametrize("reflector_m", [6.0, 9.0, 10.0, 12.0, 13.0])
def test_as_delivered_a_reflector_makes_no_false_range(reflector_m: float) -> None:
    behind = listen_to(PERIOD_MS, JITTER_MS, leader=True, reflector_m=reflector_m)
    assert behind.false < 0.01  # wild readings that confirm each other
    assert behind.missed < 0.01
    assert behind.found_s < 0.3
    assert behind.lost_s < 0.35
    alone = listen_to(PERIOD_MS, JITTER_MS, leader=False, reflector_m=reflector_m)
    assert alone.false < 0.01
    assert math.isnan(alone.found_s)


def test_the_same_seed_gives_the_same_row() -> None:
    once, again = (listen_to(60, 20, leader=True, reflector_m=11.0, seed=4) for _ in range(2))
    assert once == again


def test_the_table_in_the_readme_is_this_table() -> None:
    rows = list(late_echoes.late_echoes(((PERIOD_MS, JITTER_MS),), (6.0, 13.0)))
    text = README.read_text()
    assert " | ".join(late_echoes.HEADER) in text
    assert " | ".join(rows[0].cells()) in text  # the leader alone
    assert len(rows) == 3
