"""What is true in a flight: drawn around the belief for each seed, and set by a scenario's keys."""

import math
import statistics
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from echowing.sim.aircraft import SimFollower, SimVehicle
from echowing.sim.hangar import Hangar
from echowing.sim.scenario import load_scenario
from echowing.sim.world.gps import Errors
from echowing.sim.world.sonar import Target, TrueSonar, target_range_m
from echowing.sim.world.truth import true_errors, true_sonar
from echowing.sonar_file import ThrottleSection, load_sonar, write_sonar

SHIPPED = load_sonar("mb1202")


def follower(seed: int, *changes: str, index: int = 0) -> SimFollower:
    hangar = Hangar(load_scenario("echowing", ["law=none", *changes]), seed)
    return hangar.follower(index, (-6.0, 0.0, -10.0), 0.0, 5.0, lambda _follower, _t_s: None)


def leader(seed: int, *changes: str) -> SimVehicle:
    return Hangar(load_scenario("echowing", changes), seed).leader()


def sonar(seed: int, *changes: str) -> TrueSonar:
    """The first follower's."""
    hangar = Hangar(load_scenario("echowing", changes), seed)
    scenario = hangar.scenario
    return true_sonar(
        scenario.sonar_file, scenario.sonar, lambda name: hangar.rng(f"sonar 0 {name}")
    )


def errors(seed: int, *changes: str) -> Errors:
    hangar = Hangar(load_scenario("echowing", changes), seed)
    return true_errors(hangar.scenario.gps, lambda name: hangar.rng(f"gps leader {name}"))


def test_each_seed_and_each_follower_has_a_sonar_of_its_own_and_the_same_one_again() -> None:
    two = "formation.slots=[{radius_m=3.0}, {radius_m=8.0}]"

    assert follower(1).ear.sonar == sonar(1)
    assert follower(2).ear.sonar == sonar(2) != sonar(1)
    assert follower(1, two, index=1).ear.sonar != sonar(1)


@cache
def many_sonars() -> list[TrueSonar]:
    return [sonar(seed) for seed in range(300)]


@pytest.mark.parametrize(
    ("value", "least", "most"),
    [
        (lambda true: true.heard.at(0.2), SHIPPED.heard.least[0], SHIPPED.heard.most[0]),
        (lambda true: math.degrees(true.half_rad.at(2.0)), 14.0, 22.0),
        (lambda true: math.degrees(true.half_rad.at(4.6)), 9.0, 20.0),
        (lambda true: math.degrees(true.edge_rad), *SHIPPED.beam.edge_deg),
        (lambda true: true.noise_m, *SHIPPED.noise_m),
        (lambda true: true.foil_m, *SHIPPED.foil_to_m),
        (lambda true: true.stock_m, *SHIPPED.stock_to_m),
        (lambda true: true.inset_m, *SHIPPED.inset_m),
    ],
)
def test_nine_of_ten_sonars_are_between_what_the_file_says(
    value: Callable[[TrueSonar], float], least: float, most: float
) -> None:
    found = [value(one) for one in many_sonars()]

    # 270 expected, standard deviation 5; where a limit cuts, none is beyond it on that side.
    assert 0.85 < sum(least <= one <= most for one in found) / len(found) < 0.98
    assert statistics.fmean(found) == pytest.approx((least + most) / 2.0, abs=0.1 * (most - least))


def test_a_followers_propellers_take_what_its_sonar_file_says(tmp_path: Path) -> None:
    loud = SHIPPED.model_copy(
        update={"throttle": ThrottleSection(throttle=(0.0, 0.4), share=(1.0, 0.5))}
    )
    write_sonar(tmp_path / "loud.toml", loud)
    one = follower(1, f"sonar.file={tmp_path / 'loud.toml'}")
    assert one.ear.sonar.left.at(one.pose().throttle) == pytest.approx(1.0 - 0.5 * 0.38 / 0.4)
    usual = follower(1)
    assert usual.ear.sonar.left.at(usual.pose().throttle) == 1.0


@pytest.mark.parametrize(("to_the_right_deg", "less_m"), [(0.0, 0.45), (60.0, 0.285)])
def test_on_a_boom_it_reads_more_to_the_side(to_the_right_deg: float, less_m: float) -> None:
    """The boom does not turn with the gimbal: 0.45 m less straight ahead, and less less aside."""
    one = follower(1, "sonar.file=mb1202-boom", "sonar.spread=0")
    pose, sonar = one.pose(), one.ear.sonar
    bearing_rad = math.radians(to_the_right_deg)
    pose.axis_ned = math.cos(bearing_rad), math.sin(bearing_rad), 0.0
    north, east, down = one.position_ned_m
    there = north + 3.0 * pose.axis_ned[0], east + 3.0 * pose.axis_ned[1], down
    range_m, _ = target_range_m(pose, Target(there, 4.6, sonar.legs_m))
    # The arc that the gimbal's axis makes round the centre is worth a centimetre.
    assert range_m == pytest.approx(3.0 - less_m, abs=0.02)


def test_without_spread_all_are_the_middle() -> None:
    still = sonar(1, "sonar.spread=0")

    assert still == sonar(2, "sonar.spread=0")
    assert still.heard.at(0.2) == pytest.approx(0.8)
    assert math.degrees(still.half_rad.at(2.0)) == pytest.approx(18.0)


@pytest.mark.parametrize(
    ("changes", "value", "expected"),
    [
        (["heard_share=0.4"], lambda true: [true.heard.at(one) for one in (0.5, 4.0)], [0.4, 0.4]),
        (["deaf_share=0.25"], lambda true: true.deaf_share, 0.25),
        (["deaf_s=3"], lambda true: true.deaf_s, 3.0),
        (["beam_near_deg=12"], lambda true: _half_deg(true, 1.0, 5.0), [12.0, 12.0]),
        (
            ["beam_near_deg=20", "beam_far_deg=6"],
            lambda true: _half_deg(true, 1.0, 2.0, 3.3, 4.6, 6.0),
            [20.0, 20.0, 13.0, 6.0, 6.0],
        ),
        (["noise_m=0.05"], lambda true: true.noise_m, 0.05),
        (["wild_share=0.1"], lambda true: true.wild_share, 0.1),
        (["late_share=0.1"], lambda true: true.late_share, 0.1),
        (["tone_share=0.2"], lambda true: true.tone_share, 0.2),
        (["heard_to_m=3"], lambda true: [true.foil_m, true.stock_m], [3.0, 3.0]),
        (["inset_m=0.3"], lambda true: true.inset_m, 0.3),
    ],
)
def test_a_scenarios_key_sets_the_sonar_and_nothing_else(
    changes: list[str], value: Callable[[TrueSonar], Any], expected: Any
) -> None:
    usual, told = sonar(5), sonar(5, *(f"sonar.{one}" for one in changes))

    assert value(told) == pytest.approx(expected)
    assert value(usual) != pytest.approx(expected)
    others = {name for name in usual.__slots__ if getattr(usual, name) != getattr(told, name)}
    # Late ones that are told are not among the wild ones.
    assert len(others) == (2 if changes in (["heard_to_m=3"], ["late_share=0.1"]) else 1)


def _half_deg(true: TrueSonar, *ranges_m: float) -> list[float]:
    return [math.degrees(true.half_rad.at(one)) for one in ranges_m]


def test_the_far_end_of_a_beam_alone_leaves_the_near_one_as_drawn() -> None:
    narrow = sonar(5, "sonar.beam_far_deg=6")

    assert _half_deg(narrow, 2.0, 4.6) == pytest.approx([*_half_deg(sonar(5), 2.0), 6.0])


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("sigma_m", "sigma_m"),
        ("tau_s", "tau_s"),
        ("vertical_sigma_m", "height_sigma_m"),
        ("vertical_tau_s", "height_tau_s"),
        ("receiver_vertical_sigma_m", "receiver_height_sigma_m"),
        ("follows_s", "follows_s"),
        ("height_follows_s", "height_follows_s"),
    ],
)
def test_errors_are_drawn_around_what_is_given(key: str, name: str) -> None:
    drawn = [getattr(errors(seed, f"gps.{key}=2"), name) for seed in range(200)]
    logs = [math.log(one / 2.0) for one in drawn]

    # Known to 0.018 and 0.0125 (one standard deviation).
    assert statistics.fmean(logs) == pytest.approx(0.0, abs=0.06)
    assert statistics.pstdev(logs) == pytest.approx(0.25, abs=0.04)
    assert getattr(errors(1, f"gps.{key}=2", "gps.spread=0"), name) == 2.0


def test_what_is_given_of_one_error_changes_no_other() -> None:
    usual, other = errors(3), errors(3, "gps.sigma_m=1.5", "gps.step_m=2")

    assert other.sigma_m / usual.sigma_m == pytest.approx(1.5 / 0.8)
    assert (other.tau_s, other.height_sigma_m) == (usual.tau_s, usual.height_sigma_m)


def test_steps_and_multipath_are_as_given_and_off_by_default() -> None:
    usual = errors(1)
    told = errors(
        1, "gps.step_m=2", "gps.step_every_s=20", "gps.multipath_m=0.4", "gps.multipath_s=7"
    )

    assert (usual.step_every_s, usual.multipath_m) == (math.inf, 0.0)
    assert (told.step_m, told.step_every_s) == (2.0, 20.0)
    assert (told.multipath_m, told.multipath_s) == (0.4, 7.0)


def test_a_hovering_vehicle_really_rises_and_sinks_as_its_barometer_wanders() -> None:
    """Thesis 4.3.2.1: the leader lost over a metre of its altitude."""
    vehicle = leader(4, "gps.vertical_sigma_m=0.5", "gps.vertical_tau_s=30", "gps.spread=0")
    true_m, reported_m = [], []
    for step in range(50 * 300):
        vehicle.move(0.02)
        vehicle.autopilot.step(0.02 * (step + 1))
        true_m.append(-vehicle.body.down_m)
        reported_m.append(-vehicle.body.est_down_m)

    # By its own word it keeps its height; it answers the barometer with a lag of a second or two.
    assert statistics.pstdev(reported_m[500:]) < 0.1
    assert statistics.pstdev(true_m) > 0.3
    assert max(true_m) - min(true_m) > 1.0


def test_heights_wander_by_half_a_metre_by_default_and_not_when_told() -> None:
    off_m = [one.body.est_down_m - one.body.down_m for one in map(leader, range(200))]
    still = leader(1, "gps.vertical_sigma_m=0")

    assert statistics.pstdev(off_m) == pytest.approx(0.5, rel=0.2)
    assert still.body.est_down_m == still.body.down_m
    assert still.body.est_north_m == leader(1).body.est_north_m


def test_a_follower_flies_by_its_receivers_height_if_its_parameter_says_so() -> None:
    by_receiver = "follower.parameters={EK3_SRC1_POSZ=3}"
    one = follower(2, by_receiver)

    assert one.body.est_down_m - one.body.down_m == one.drift.receiver_down_m
    assert follower(2).body.est_down_m - follower(2).body.down_m != one.drift.receiver_down_m


def test_the_belief_is_of_the_leaders_legs() -> None:
    foil = load_scenario("echowing").sonar_belief
    stock = load_scenario("echowing", ["leader.target=stock"]).sonar_belief

    assert (foil.heard_to_m, stock.heard_to_m) == (4.0, 2.8)
    assert stock.silent_to_m == pytest.approx(0.7 * foil.silent_to_m)
