"""The figures of a formation, on records made up for them."""

import math
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from echowing.campaign.draw import draw, load_description
from echowing.campaign.fly import Row
from echowing.campaign.record import FlightRecord, fly_recorded
from echowing.campaign.report import write_report
from echowing.campaign.swarm import swarm
from echowing.sim.scenario import load_scenario, scenario_of

SLOTS_M = [(3.0, 0.0), (9.0, 0.0), (9.0, 90.0), (9.0, -90.0)]


@cache
def flown() -> FlightRecord:
    """The first seconds of a flight of four: its scenario and shapes are what is used."""
    slots = [{"radius_m": radius_m, "angle_deg": angle_deg} for radius_m, angle_deg in SLOTS_M]
    table = {"title": "t", "duration_s": 1.0, "formation": {"slots": slots}}
    return fly_recorded(scenario_of(table, "test"), 1)


def made_up(place_m: list[tuple[float, float]], mps: list[tuple[float, float]]) -> FlightRecord:
    """The same at each moment: followers' places and velocities, north and east."""
    record = flown()
    position, velocity = record.position_ned_m.copy(), record.velocity_ned_mps.copy()
    position[:, 1:, :2], velocity[:, 1:, :2] = place_m, mps
    return replace(
        record,
        time_s=record.time_s + 30.0,
        position_ned_m=position,
        velocity_ned_mps=velocity,
        hold=[[""] * len(SLOTS_M) for _ in record.time_s],
    )


IN_SLOTS = [(-3.0, 0.0), (-9.0, 0.0), (0.0, 9.0), (0.0, -9.0)]


def test_a_formation_in_its_slots_that_flies_one_way_is_whole() -> None:
    figures = swarm(made_up(IN_SLOTS, [(0.0, 2.0)] * 4))

    assert figures is not None
    assert figures.spread == pytest.approx(1.0)
    assert figures.polarisation == pytest.approx(1.0)
    assert figures.rotation == pytest.approx(0.0, abs=0.3)
    assert figures.misaligned_mps == pytest.approx(0.0)
    # 6 m for the two behind each other, and for the two abeam 3 m back: 9.49 m.
    assert figures.nearest_m == pytest.approx((6.0 + 6.0 + 2.0 * math.hypot(9.0, 3.0)) / 4.0)
    assert figures.held == 0.0


def test_one_that_goes_round_its_centre_turns_and_is_not_polarised() -> None:
    ring = [(5.0, 0.0), (0.0, 5.0), (-5.0, 0.0), (0.0, -5.0)]
    figures = swarm(made_up(ring, [(0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0)]))

    assert figures is not None
    assert figures.rotation == pytest.approx(1.0)
    assert figures.polarisation == pytest.approx(0.0, abs=1e-9)
    assert figures.misaligned_mps == pytest.approx(1.0)


def test_twice_as_far_apart_is_twice_the_spread_however_it_points() -> None:
    turned = [(2.0 * east, -2.0 * north) for north, east in IN_SLOTS]
    figures = swarm(made_up(turned, [(1.0, 0.0)] * 4))

    assert figures is not None
    assert figures.spread == pytest.approx(2.0)


def test_a_line_of_which_each_slot_is_behind_the_one_before_is_whole_too() -> None:
    line = made_up([(-3.0 * place, 0.0) for place in (1, 2, 3, 4)], [(2.0, 0.0)] * 4)
    column = load_scenario("column", ["formation.followers=4"])
    figures = swarm(replace(line, scenario=column))

    assert figures is not None
    assert figures.spread == pytest.approx(1.0)


def test_who_hardly_moves_has_no_direction_and_who_is_held_is_counted() -> None:
    record = made_up(IN_SLOTS, [(0.0, 2.0), (0.0, 2.0), (0.0, 2.0), (0.0, -0.1)])
    held = [["", "", "", "leader is stale"] for _ in record.time_s]
    figures = swarm(replace(record, hold=held))

    assert figures is not None
    assert figures.polarisation == pytest.approx(1.0)
    assert figures.held == pytest.approx(0.25)
    assert swarm(made_up(IN_SLOTS, [(0.0, 0.1)] * 4)) is None


def test_before_it_has_settled_and_for_a_pair_there_are_no_figures() -> None:
    early = made_up(IN_SLOTS, [(0.0, 2.0)] * 4)
    assert swarm(replace(early, time_s=early.time_s - 30.0)) is None
    pair = replace(
        early,
        position_ned_m=early.position_ned_m[:, :3],
        velocity_ned_mps=early.velocity_ned_mps[:, :3],
    )
    assert swarm(pair) is None


def test_many_draws_fifty_in_a_filled_vee_behind_radios_that_lose_the_same_on_each_way() -> None:
    description = load_description("many")
    drawn = [draw(description, 1, index) for index in range(24)]

    assert {len(one.slots()) for one in drawn} == {50}
    places_m = [
        (slot.radius_m * math.cos(slot.angle_rad), slot.radius_m * math.sin(slot.angle_rad))
        for slot in drawn[0].slots()
    ]
    rows = Counter(round(back_m, 1) for back_m, _ in places_m)
    assert list(rows.values()) == [1, 2, 3, 4, 5, 6, 7, 8, 9, 5]
    # The ground tool leads nobody who is further than 100 m from the leader (`--max-distance`).
    assert max(math.hypot(*one) for one in places_m) < 60.0
    apart_m = min(math.dist(a, b) for n, a in enumerate(places_m) for b in places_m[:n])
    assert apart_m == pytest.approx(5.2, abs=0.01)
    higher_m = [slot.altitude_step_m for slot in drawn[0].slots()]
    near = [
        (a, b) for b in range(50) for a in range(b) if math.dist(places_m[a], places_m[b]) < 6.0
    ]
    assert {abs(higher_m[a] - higher_m[b]) for a, b in near} == {2.0}
    losses = Counter((one.radio.leader.loss, one.radio.follower.loss) for one in drawn)
    assert set(losses) == {(0.0, 0.0), (0.1, 0.1), (0.3, 0.3), (0.5, 0.5)}
    assert not any(one.fault for one in drawn)


def test_the_report_shows_formations_by_the_messages_lost(tmp_path: Path) -> None:
    figures = dict.fromkeys(("misaligned_mps", "rotation", "held"), 0.0)
    shared = {
        **{
            "closest_m": 2.0,
            "mean_error_m": 0.1,
            "faults": [],
            "in_force_s": {},
            "states_s": {},
            "broken": [],
        },
        **figures,
        "seed": 1,
    }

    def row(index: int, loss: float, least_m: float, spread: float | None) -> Row:
        polarisation = None if spread is None else 0.9
        own = {"index": index, "loss": loss, "closest_followers_m": least_m, "spread": spread}
        return {**shared, **own, "polarisation": polarisation, "nearest_m": 7.0}

    rows = [row(0, 0.0, 3.0, 1.0), row(1, 0.3, 2.5, 1.1), row(2, 0.3, 2.0, 1.3)]
    write_report(tmp_path, [*rows, row(3, 0.1, 1.0, None)], 1, [])

    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "up to 0 %" in text
    assert "up to 10 %" not in text
    line = text[text.index("up to 30 %") :]
    cells = [one.partition("<")[0] for one in line.split("<td>")[1:5]]
    assert cells == ["2", "2.00", "7.00", "1.20"]
