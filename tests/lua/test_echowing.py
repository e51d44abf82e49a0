"""What the applet does around its laws: control, safety, messages. The file itself runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from echowing.paths import lua_folder
from echowing.sim.vehicle.luahost import BINDINGS, LuaHost

if TYPE_CHECKING:
    from tests.lua.conftest import MakeRig, Names, Rig

PILOT_MPS = 10.0
LOW, NO_DATA, HIGH, GOOD = 2, 1, 3, 4
SEARCHING, TRACKING, TOO_CLOSE, NO_SONAR, STREAM_LOST = 1, 2, 3, 4, 5
FLOOR_MPS = pytest.approx(0.2)
NOT_HELD_MPS = 3.0  # ECHO_SPD_LOST


def flying_along(r: Rig, speed_mps: float = 2.5, range_m: float = 3.0) -> Rig:
    """Behind a leader of the same speed, so that nothing closes."""
    r.vehicle.velocity = (speed_mps, 0.0, 0.0)
    return r.range(range_m)


# Control


def test_writes_parameter_and_limit_at_every_update(rig: MakeRig) -> None:
    r = flying_along(rig()).run(2.0)
    assert len(r.vehicle.desired_speeds) >= 35  # 20 a second once it is ready
    assert r.parameter_mps == r.speed_mps == NOT_HELD_MPS  # ECHO_SPD_INIT
    assert r.names.speed not in r.vehicle.saved


@pytest.mark.parametrize(
    ("leave", "why"),
    [
        (lambda r: setattr(r.vehicle, "mode", 5), "mode"),
        (lambda r: setattr(r.vehicle, "is_armed", False), "disarmed"),
        (lambda r: r.vehicle.parameters.update(ECHO_ENABLE=0.0), "disabled"),
        (lambda r: r.vehicle.switches.update({300: 0}), "switch"),
    ],
)
def test_hands_the_pilots_value_back(rig: MakeRig, leave: object, why: str) -> None:
    r = rig(SWITCH=300)
    r.vehicle.switches[300] = 2
    r.range(1.2).run(3.0)
    assert r.parameter_mps < 1.0
    assert r.mirror_mps == PILOT_MPS
    assert callable(leave)
    leave(r)
    r.run(0.6)
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0
    assert r.texts[-1].startswith("handed back")
    assert why in r.texts[-1]
    writes = len(r.vehicle.desired_speeds)
    r.run(2.0)
    assert len(r.vehicle.desired_speeds) == writes  # hands off


def test_limit_in_guided_is_the_pilots_again_after_the_switch(rig: MakeRig) -> None:
    r = rig(SWITCH=301)
    r.vehicle.switches[301] = 2
    r.range(1.2).run(3.0)
    r.vehicle.switches[301] = 1  # the middle is not high
    r.run(0.2)
    assert r.speed_mps == PILOT_MPS


def test_another_modes_speed_is_left_alone(rig: MakeRig) -> None:
    r = rig().range(1.2).run(3.0)
    r.vehicle.mode = 3
    writes = len(r.vehicle.desired_speeds)
    r.run(1.0)
    assert len(r.vehicle.desired_speeds) == writes


@pytest.mark.parametrize("switch", [300, 7, 303.5])
def test_does_not_act_without_the_switch_it_is_told_of(rig: MakeRig, switch: float) -> None:
    r = rig(SWITCH=switch).range(1.2).run(2.0)
    assert r.vehicle.desired_speeds == []
    assert r.parameter_mps == PILOT_MPS


@pytest.mark.parametrize(("enable", "armed", "mode"), [(0, True, 4), (1, False, 4), (1, True, 5)])
def test_acts_only_enabled_armed_and_in_guided(
    rig: MakeRig, enable: int, armed: bool, mode: int
) -> None:
    r = rig(ENABLE=enable)
    r.vehicle.is_armed, r.vehicle.mode = armed, mode
    r.range(1.2).run(3.0)
    assert r.vehicle.desired_speeds == []
    assert r.parameter_mps == PILOT_MPS


def test_pilot_may_change_the_speed_parameter_in_flight(rig: MakeRig) -> None:
    r = flying_along(rig()).run(2.0)
    r.vehicle.parameters[r.names.speed] = 7.0 * r.names.units_per_mps
    r.run(0.5)
    assert r.parameter_mps == r.speed_mps == NOT_HELD_MPS
    assert r.mirror_mps == 7.0
    r.vehicle.mode = 5
    r.run(0.5)
    assert r.parameter_mps == 7.0


def test_pilot_may_set_the_speed_and_leave_guided_at_once(rig: MakeRig) -> None:
    """Both between two updates, which are 50 ms apart."""
    r = flying_along(rig()).run(2.0)
    r.vehicle.parameters[r.names.speed] = 7.0 * r.names.units_per_mps
    r.vehicle.mode = 5
    r.run(0.5)
    assert r.parameter_mps == 7.0


def test_gives_up_against_another_script(rig: MakeRig) -> None:
    r = rig().range(3.0).run(2.0)
    for _ in range(20):
        r.vehicle.parameters[r.names.speed] = 6.0 * r.names.units_per_mps
        r.run(0.1)
    assert f"another script sets {r.names.speed}" in r.texts[-1]
    writes = len(r.vehicle.desired_speeds)
    r.run(5.0)
    assert len(r.vehicle.desired_speeds) == writes


# Restart and death


def test_restarted_script_restores_the_pilots_value(rig: MakeRig) -> None:
    r = rig().range(1.2).run(3.0)
    low = r.parameter_mps
    r.restart_script()
    r.vehicle.mode = 5
    r.run(0.1)
    assert low < PILOT_MPS
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0
    assert "restarted" in "".join(r.texts)


def test_restart_in_flight_does_not_take_its_own_low_value_for_the_pilots(rig: MakeRig) -> None:
    r = rig().range(1.2).run(3.0)
    r.restart_script()
    r.run(2.0)
    assert r.mirror_mps == PILOT_MPS
    r.vehicle.mode = 5
    r.run(0.5)
    assert r.parameter_mps == PILOT_MPS


@pytest.mark.parametrize("instructions", [*range(1, 1500, 37)])
def test_killed_anywhere_in_an_update_the_pilots_value_survives(
    rig: MakeRig, instructions: int
) -> None:
    r = rig().range(1.2).run(1.0)
    vehicle = r.vehicle
    if instructions % 2:
        vehicle.mode = 5  # half of them die while handing back
    r.host.kill_after(instructions)
    while r.host.running and vehicle.t_ms < 2000:
        vehicle.t_ms += 10
        r.host.step(vehicle.t_ms)
    vehicle.mode = 5
    r.restart_script()
    r.run(1.0)
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0


def test_killed_while_taking_control(rig: MakeRig) -> None:
    for instructions in range(1, 1200, 23):
        r = rig(ENABLE=0).range(1.2).run(0.5)
        r.vehicle.parameters["ECHO_ENABLE"] = 1.0
        r.host.kill_after(instructions)
        while r.host.running and r.vehicle.t_ms < 1500:
            r.vehicle.t_ms += 10
            r.host.step(r.vehicle.t_ms)
        r.vehicle.mode = 5
        r.restart_script()
        r.run(1.0)
        assert r.parameter_mps == PILOT_MPS, instructions


def test_after_a_reboot_nothing_is_left_behind(rig: MakeRig) -> None:
    r = rig().range(1.2).run(3.0)
    r.reboot()
    r.vehicle.mode = 5
    r.run(1.0)
    assert r.parameter_mps == PILOT_MPS
    assert not any("restarted" in text for text in r.texts)


def test_an_error_is_told_once_with_its_place_and_hands_back(rig: MakeRig) -> None:
    r = rig().range(1.4).run(3.0)
    r.host.local_value("C")["NODATA_T"] = "x"  # as a bug would: arithmetic on a word
    r.vehicle.parameters["ECHO_NODATA_T"] = math.nan  # and nothing puts it right
    r.host.local_value("complained")["NODATA_T"] = True
    r.raw_every_ms = 50
    r.run(5.0)
    errors = [text for text in r.texts if text.startswith("error")]
    assert len(errors) == 1
    assert "scripts/echowing.lua:" in errors[0]
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0
    r.vehicle.parameters["ECHO_NODATA_T"] = 1.0
    r.run(12.0)
    assert r.parameter_mps < 1.0  # it tried again


def test_says_what_the_firmware_lacks_and_stops(rig: MakeRig, tmp_path: Path) -> None:
    source = (lua_folder() / "echowing.lua").read_text(encoding="utf-8")
    script = tmp_path / "echowing.lua"
    script.write_text("vehicle = { get_mode = true }\n" + source, encoding="utf-8")
    r = rig(script)
    r.run(0.5)
    assert not r.host.running
    assert r.texts == ["stopped, this firmware is not Copter 4.5 or newer"]


def test_stops_without_a_speed_parameter(rig: MakeRig) -> None:
    r = rig()
    del r.vehicle.parameters[r.names.speed]
    r.restart_script()
    r.run(0.5)
    assert r.texts == ["stopped, this firmware is not Copter 4.5 or newer"]


def test_stops_when_its_parameter_key_is_taken(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.tables[95] = "OTHER_"
    r.vehicle.t_ms = 10
    r.host.step(10)
    assert "parameter table key 95 is taken" in str(r.host.error)


@pytest.mark.parametrize("velocity_mps", [None, 0.0])
def test_an_update_stays_far_below_the_limits(rig: MakeRig, velocity_mps: float | None) -> None:
    """A quarter of SCR_VM_I_COUNT an update with two messages, over half of the heap is free."""
    r = rig()
    r.host = LuaHost(r.vehicle, r.script, generation=r.names.generation, count_instructions=True)
    r.raw_every_ms = 50
    worst = 0
    for i in range(500):
        if i % 5 == 0:
            r.send_target(5.0, velocity_mps)
        r.range(3.0 if i < 250 else 1.2).step()
        if r.vehicle.t_ms > 500:  # the first run sets everything up
            worst = max(worst, r.host.instructions)
    assert 200 < worst < 2500
    # Here pointers take 64 bits, on the autopilot half of that: about a quarter of its heap.
    assert r.host.heap_bytes() < 204800 * 0.6


# Too close


def test_too_close_wins_once_three_readings_agree(rig: MakeRig) -> None:
    r = flying_along(rig(), range_m=3.5).run(4.0)
    assert r.speed_mps == NOT_HELD_MPS
    r.range(1.2).run(0.25)
    assert r.speed_mps == FLOOR_MPS
    assert r.parameter_mps == FLOOR_MPS


def test_wild_readings_among_none_are_no_target(rig: MakeRig) -> None:
    """Nothing in range but now and then an echo from nowhere: it slows while that is the newest."""
    r = rig().range(7.66, HIGH).run(3.0)
    assert r.speed_mps == 3.0
    for i in range(98):
        r.send_raw(1.1 if i % 7 in (0, 1) else 7.66)
        r.run(0.05)
    assert "too close" not in " ".join(r.texts)
    assert r.vehicle.targets == []
    assert r.speed_mps == 3.0


@pytest.mark.parametrize(
    "reading",
    [
        {"metres": 0.9, "system": 9},  # another vehicle's co-processor
        {"metres": 0.9, "name": b"SNR_PAN"},
        {"metres": math.nan},
        {"metres": -1.0},
        {"metres": 0.0},
        {"metres": math.inf},
    ],
)
def test_readings_that_are_none_change_nothing(rig: MakeRig, reading: dict[str, object]) -> None:
    r = rig().range(3.0).run(2.0)
    before = r.speed_mps
    r.send_raw(**reading)  # type: ignore[arg-type]
    r.run(0.1)
    assert r.speed_mps == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize(("metres", "status"), [(math.nan, GOOD), (-2.0, GOOD), (0.0, GOOD)])
def test_ranges_that_are_none_change_nothing(rig: MakeRig, metres: float, status: int) -> None:
    r = flying_along(rig()).run(2.0)
    r.range(metres, status).run(1.0)
    assert r.speed_mps == NOT_HELD_MPS


def test_out_of_range_low_is_too_close(rig: MakeRig) -> None:
    r = rig().range(3.0).run(2.0)
    r.range(3.0, LOW).run(0.1)  # whatever the number says
    assert r.speed_mps == FLOOR_MPS


def test_no_data_with_distance_0_is_nothing(rig: MakeRig) -> None:
    r = flying_along(rig()).run(2.0)
    r.no_data().run(0.5)
    assert r.speed_mps == NOT_HELD_MPS


def close_in(r: Rig, start_m: float, closing_mps: float, seconds: float, own_mps: float) -> float:
    """The range shrinks steadily: a single reading every 50 ms. Gives where it ends."""
    return brake(r, start_m, closing_mps, closing_mps, seconds, own_mps)


def brake(
    r: Rig, start_m: float, from_mps: float, to_mps: float, seconds: float, own_mps: float
) -> float:
    """The leader brakes by 2.5 m/s2, from one closing speed to another. Gives where it ends."""
    r.vehicle.velocity = (own_mps, 0.0, 0.0)
    metres, closing_mps = start_m, from_mps
    for i in range(round(seconds * 100)):
        r.range(metres)
        if i % 5 == 0:
            r.send_raw(round(metres, 2))
        r.step()
        closing_mps = min(to_mps, closing_mps + 0.025)
        metres -= closing_mps / 100.0
    return metres


def test_closing_distance_counts(rig: MakeRig) -> None:
    """At 1.5 m/s: 1.5 x 0.6 + 1.5^2 / 5 = 1.35 m, so too close under 1.5 + 1.35 = 2.85 m."""
    r = flying_along(rig(), 1.5, 4.4).run(2.0)
    near_m = brake(r, 4.4, 0.0, 1.5, 0.6, own_mps=1.5)
    near_m = close_in(r, near_m, 1.5, (near_m - 3.05) / 1.5, own_mps=1.5)
    assert r.speed_mps > 1.0
    close_in(r, near_m, 1.5, 0.3, own_mps=1.5)  # to 2.6 m
    assert r.speed_mps == FLOOR_MPS


def approach(r: Rig, range_m: float, speed_mps: float, accel_mps2: float, seconds: float) -> None:
    """Towards a leader that stands, readings every 50 ms, which are as old when they come."""
    before_m = range_m
    for i in range(round(seconds * 100)):
        speed_mps += accel_mps2 * 0.01
        range_m -= speed_mps * 0.01
        r.vehicle.velocity = (speed_mps, 0.0, 0.0)
        r.range(range_m)
        if i % 5 == 0:
            r.send_raw(round(before_m, 2))
            before_m = range_m
        r.step()


def test_acceleration_under_way_counts(rig: MakeRig) -> None:
    """2 m/s^2 at 1 m/s make 1 + 2 x 0.1 + 2^2 / 10 = 1.6 m/s: too close under 2.97, not 2.3 m."""
    steady = rig()
    flying_along(steady, 1.0, 3.4).run(2.0)
    approach(steady, 3.4, 1.0, 0.0, 0.8)
    rising = rig().range(2.85).run(2.0)
    approach(rising, 2.85, 0.0, 2.0, 0.5)  # to 2.6 m as well
    assert steady.speed_mps == NOT_HELD_MPS
    assert rising.speed_mps == FLOOR_MPS


def test_a_jump_of_the_estimated_speed_is_no_acceleration(rig: MakeRig) -> None:
    """One step of 2 m/s in an update would be 40 m/s^2: no more counts than the vehicle can."""
    r = flying_along(rig(), 1.0, 3.4).run(2.0)
    r.vehicle.velocity = (1.5, 0.0, 0.0)
    r.run(0.1)
    assert r.speed_mps > 1.0


def test_standing_still_at_the_same_range_is_not_too_close(rig: MakeRig) -> None:
    r = rig().range(2.65).run(3.0)
    assert r.speed_mps > 1.0


def test_free_to_get_away_when_the_target_leads_away(rig: MakeRig) -> None:
    r = rig()
    r.stream_every_ms, r.ahead_m = 120, -3.0
    r.range(3.0).run(2.0)
    close_in(r, 2.0, 1.0, 0.9, own_mps=0.0)
    assert r.speed_mps == 5.0  # ECHO_SPD_MAX
    assert r.vehicle.targets == []  # the stream does it


def test_backs_off_from_a_leader_that_closes(rig: MakeRig) -> None:
    r = rig()
    r.stream_every_ms, r.ahead_m = 120, 2.0
    r.range(3.0).run(2.0)
    close_in(r, 2.5, 1.0, 1.2, own_mps=0.0)
    assert r.target_ahead_m() < -1.5  # beyond the wanted distance: 3 - 1.3 m and the approach
    assert r.speed_mps == 5.0
    assert r.texts[-1] == "too close, backing off"
    r.range(3.0)
    r.raw_every_ms, r.raw_m = 50, 3.0
    r.run(1.0)
    targets = len(r.vehicle.targets)
    r.run(1.0)
    assert len(r.vehicle.targets) == targets  # the stream's again
    assert r.speed_mps < 5.0


def test_backing_off_is_reported_at_once(rig: MakeRig) -> None:
    """Not up to half a second later: the tool would call it back to where it holds it."""
    r = rig()
    r.stream_every_ms, r.ahead_m = 120, 2.0
    r.range(3.0).run(2.0)
    near_m = 2.5
    while "too close, backing off" not in r.texts:
        near_m = close_in(r, near_m, 1.0, 0.05, own_mps=0.0)
    assert r.state == 6


def test_backs_off_from_a_leader_that_comes_until_the_wanted_distance_is_left(
    rig: MakeRig,
) -> None:
    """As fast as its leader it stopped again, and was met at 0.3 m by one that flew on."""
    r = rig()
    r.range(4.0).run(2.0)
    close_in(r, 4.0, 2.2, 1.7, own_mps=0.0)
    assert r.texts[-1] == "too close, backing off"
    r.vehicle.velocity = (-1.7, 0.0, 0.0)
    r.raw_every_ms, r.raw_m = 50, 2.2
    r.range(2.2).run(1.0)
    targets = len(r.vehicle.targets)
    r.run(0.5)
    assert len(r.vehicle.targets) > targets
    assert r.target_ahead_m() < -1.7  # 0.8 m to the wanted 3 m, and its approach of a second
    r.raw_m = 3.4
    r.range(3.4).run(1.0)
    targets = len(r.vehicle.targets)
    r.run(0.5)
    assert len(r.vehicle.targets) == targets


@pytest.mark.parametrize(("height_m", "backs_off"), [(0.6, False), (1.4, False), (1.6, True)])
def test_what_is_near_in_a_take_off_is_the_ground(
    rig: MakeRig, height_m: float, *, backs_off: bool
) -> None:
    """Hovering 0.6 m up it flew back from the ground with 2.4 m/s; below 1.5 m it is slow."""
    r = rig()
    r.vehicle.height_m = height_m
    r.range(3.0).run(2.0)
    close_in(r, 2.5, 1.0, 1.2, own_mps=0.0)
    assert bool(r.vehicle.targets) is backs_off
    if not backs_off:
        assert r.speed_mps == FLOOR_MPS
        assert r.texts[-1] == "too close"


def test_backs_off_along_the_heading(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.yaw = math.pi / 2  # facing east: back is west
    r.range(3.0).run(2.0)
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    close_in(r, 2.5, 1.0, 1.2, own_mps=0.0)
    kind, (north_m, east_m, down_m, _, _, _, yaw_rad, *_) = r.vehicle.targets[-1]
    assert kind == "posvel"
    assert north_m == pytest.approx(0.0, abs=1e-3)
    assert float(east_m or 0.0) < -1.5
    assert down_m == -10.0
    assert yaw_rad == pytest.approx(math.pi / 2)  # the sonar keeps looking at the leader


def test_a_posvel_target_towards_the_leader_does_not_lead_away(rig: MakeRig) -> None:
    r = rig().range(3.0).run(2.0)
    r.vehicle.takes_posvel = False  # nothing is held, the guard watches
    for _ in range(10):
        r.send_target(-1.0, velocity_mps=1.0)
        r.range(0.8).run(0.1)
    assert r.speed_mps == FLOOR_MPS


def test_no_targets_of_its_own_on_the_ground(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.is_flying = False
    r.stream_every_ms = 120
    r.range(3.0).run(2.0)
    r.stream_every_ms = None
    close_in(r, 2.5, 1.0, 1.5, own_mps=0.0)
    assert r.vehicle.targets == []
    assert r.speed_mps == FLOOR_MPS


# Sonar lost


def test_silent_sonar_means_the_no_sonar_speed_told_once(rig: MakeRig) -> None:
    r = rig(SPD_LOST=1.5)
    r.vehicle.velocity = (2.0, 0.0, 0.0)
    r.range(3.5).run(3.0)
    r.no_data().run(0.9)
    assert "no sonar data" not in " ".join(r.texts)
    r.run(5.0)
    assert r.speed_mps == 1.5
    assert [t for t in r.texts if t.startswith("no sonar data")] == ["no sonar data, 1.5 m/s"]
    assert r.mirror_mps == PILOT_MPS  # still in control: the pilot's value waits


def test_flapping_does_not_spam(rig: MakeRig) -> None:
    r = rig(LOST_T=0.3).range(3.0).run(2.0)
    before = len(r.texts)
    for _ in range(30):
        r.range(7.0, HIGH).run(0.5)
        r.range(3.0).run(0.5)
    assert len(r.texts) - before <= 7  # thirty losses in 30 s; each state at most every 10 s


# Stream watchdog


def test_holds_where_it_is_when_the_stream_falls_silent(rig: MakeRig) -> None:
    r = rig()
    r.stream_every_ms = 120
    r.range(3.0).run(3.0)
    assert r.vehicle.targets == []
    r.stream_every_ms = None
    r.run(0.9)
    assert r.vehicle.targets == []
    r.run(0.4)
    assert len(r.vehicle.targets) == 1
    assert r.target_ahead_m() == pytest.approx(0.0, abs=0.02)
    assert r.vehicle.mode == 4
    assert r.texts[-1] == "stream lost, holding here"
    assert r.run(1.0).state == STREAM_LOST
    assert len(r.vehicle.targets) == 1  # told once, it stays
    r.stream_every_ms = 120
    r.run(1.0)
    assert r.state == TRACKING


def test_hold_is_repeated_until_it_is_accepted(rig: MakeRig) -> None:
    r = rig()
    r.stream_every_ms = 120
    r.range(3.0).run(3.0)
    r.stream_every_ms = None
    r.vehicle.position = None
    r.run(2.0)
    assert r.vehicle.targets == []
    r.vehicle.position = (0.0, 0.0, -10.0)
    r.run(0.2)
    assert len(r.vehicle.targets) == 1


def test_a_stream_for_another_vehicle_is_not_ours(rig: MakeRig) -> None:
    r = rig().range(3.0).run(2.0)
    for _ in range(10):
        r.send_target(3.0, system=9)
        r.run(0.1)
    r.run(3.0)
    assert r.vehicle.targets == []


def test_watchdog_can_be_turned_off(rig: MakeRig) -> None:
    r = rig(STREAM_T=0)
    r.stream_every_ms = 120
    r.range(3.0).run(2.0)
    r.stream_every_ms = None
    r.run(5.0)
    assert r.vehicle.targets == []


# Parameters


def test_wrong_values_are_told_and_do_not_count(rig: MakeRig) -> None:
    r = rig(SPD_MIN=0.0).range(1.2).run(4.0)
    assert min(r.vehicle.desired_speeds) == FLOOR_MPS
    assert r.texts.count("ECHO_SPD_MIN out of range, using 0.20") == 1
    r.vehicle.parameters["ECHO_SPD_MAX"] = math.nan
    r.run(2.0)
    assert r.texts.count("ECHO_SPD_MAX out of range, using 5.00") == 1


def test_parameters_change_in_flight(rig: MakeRig) -> None:
    r = rig().range(3.0).run(2.0)
    r.vehicle.parameters["ECHO_SPD_LOST"] = 1.0
    r.run(0.5)
    assert r.speed_mps == 1.0


def test_parameter_names_fit_and_are_documented() -> None:
    source = (lua_folder() / "echowing.lua").read_text(encoding="utf-8")
    documented = [line.split()[-1] for line in source.splitlines() if "// @Param:" in line]
    assert len(documented) == len(set(documented)) == 19
    assert all(len(name) <= 16 for name in documented)
    for field in ("@DisplayName", "@Description", "@User"):
        assert source.count(f"// {field}:") == len(documented)
    doc = (lua_folder() / "echowing.md").read_text(encoding="utf-8")
    assert [name for name in documented if name not in doc] == []


def test_every_text_is_explained_in_the_doc() -> None:
    doc = (lua_folder() / "echowing.md").read_text(encoding="utf-8")
    for text in (
        "searching",
        "tracking",
        "too close",
        "backing off",
        "no sonar data",
        "stream lost, holding here",
        "holding the distance",
        "in control",
        "handed back",
        "restarted",
        "out of range, using",
        "another script sets",
        "no forward rangefinder",
        "no arming check",
        "stopped",
        "error",
        "ready",
        "damaged message, not used",
        "implausible point, not used",
        "implausible reading, not used",
        "implausible target, not used",
        "implausible speed, not used",
        "points of another format, not used",
        "points of a second sender, not used",
        "other scripts leave no place to receive",
    ):
        assert f"`{text}" in doc or text in doc, text


def test_only_annotated_bindings_are_allowed_by_luacheck() -> None:
    """The globals that luacheck lets pass are ones the type annotations know."""
    settings = (lua_folder() / ".luacheckrc").read_text(encoding="utf-8")
    listed = [word for word in settings.split('"') if word.isidentifier()][1:]
    annotations = BINDINGS.read_text(encoding="utf-8")
    for name in listed:
        assert f"\n{name} = {{}}" in annotations or f"\nfunction {name}(" in annotations, name


# Arming


def arming_reason(r: Rig) -> str | None:
    r.run(2.5)
    (reason,) = r.vehicle.auth.values()
    return reason


def on_the_ground(rig: MakeRig, **applet: float) -> Rig:
    r = rig(**applet)
    r.vehicle.is_armed = False
    return r


def test_may_arm_with_a_mavlink_rangefinder(rig: MakeRig) -> None:
    assert arming_reason(on_the_ground(rig)) is None


def test_refuses_to_arm_without_a_forward_rangefinder(rig: MakeRig) -> None:
    r = on_the_ground(rig)
    r.vehicle.ranges = {25: (GOOD, 3.0)}
    assert arming_reason(r) == "ECHO: no forward rangefinder"
    r.vehicle.ranges = {}
    assert arming_reason(r) == "ECHO: no forward rangefinder"


def test_second_rangefinder_may_be_the_forward_one(rig: MakeRig) -> None:
    r = on_the_ground(rig)
    r.vehicle.ranges = {25: (NO_DATA, 0.0), 0: (GOOD, 3.0)}
    assert arming_reason(r) is None


def test_refuses_to_arm_while_another_script_sets_the_speed(rig: MakeRig) -> None:
    r = on_the_ground(rig)
    for i in range(12):
        r.vehicle.parameters[r.names.speed] = (5.0 + i % 2) * r.names.units_per_mps
        r.run(0.3)
    assert arming_reason(r) == f"ECHO: another script sets {r.names.speed}"
    r.run(12.0)
    assert arming_reason(r) is None


@pytest.mark.parametrize("applet", [{"ARM_CHK": 0}, {"ENABLE": 0}])
def test_arming_check_can_be_turned_off(rig: MakeRig, applet: dict[str, float]) -> None:
    r = on_the_ground(rig, **applet)
    r.vehicle.ranges = {}
    assert arming_reason(r) is None


def test_goes_on_without_an_authorisation_id(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.free_auth_ids = 0
    flying_along(r).run(1.0)
    assert "no arming check, all authorisation ids are taken" in r.texts
    assert r.speed_mps == NOT_HELD_MPS


# Reports


def test_named_floats_and_log(rig: MakeRig) -> None:
    r = rig(LOG_HZ=5)
    r.raw_every_ms = 50
    flying_along(r, 4.0, 3.5).run(10.0)
    named = r.vehicle.named
    assert set(named) == {"ECHO_RNG", "ECHO_SPD", "ECHO_STATE"}
    assert named["ECHO_RNG"][-1] == 3.5
    assert named["ECHO_SPD"][-1] == r.speed_mps
    assert 18 <= len(named["ECHO_RNG"]) <= 21  # 2 a second
    assert 45 <= len(r.vehicle.log) <= 51
    name, (range_m, filtered_m, error_m, speed, state, refused) = r.vehicle.log[-1]
    assert name == "ECHO"
    assert (range_m, error_m, speed, state, refused) == (3.5, 0.5, r.speed_mps, TRACKING, 0)
    assert filtered_m == pytest.approx(3.5, abs=0.01)


def test_log_can_be_turned_off(rig: MakeRig) -> None:
    assert rig(LOG_HZ=0).range(3.0).run(3.0).vehicle.log == []


def test_one_text_a_change_of_state(rig: MakeRig) -> None:
    r = rig()
    r.raw_every_ms = 50
    r.range(3.0).run(3.0)
    r.range(7.66, HIGH).run(3.0)
    r.range(3.0).run(12.0)
    r.range(1.2).run(3.0)
    r.range(3.0).run(12.0)
    r.vehicle.mode = 5
    r.run(1.0)
    pilots = f"{PILOT_MPS * r.names.units_per_mps:.2f}"
    assert r.texts == [
        "ready",
        "in control",
        "searching, 3.0 m/s",
        "tracking",
        "too close",
        "tracking",
        f"handed back, {r.names.speed} {pilots} (mode)",
    ]


def test_generations_differ_only_in_names(names: Names) -> None:
    assert (names.speed == "WP_SPD") == (names.units_per_mps == 1.0)
