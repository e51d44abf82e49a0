"""The speed applet: the thesis's laws to the digit, its guard, and that it gives the speed back."""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from tests.lua.conftest import (
    CO_PROCESSOR,
    GROUND_TOOL,
    HERE,
    POSITION_ONLY,
    STEP_MS,
    Rig,
    mavlink_frame,
)

from echowing.paths import lua_folder
from echowing.sim.vehicle.luahost import LuaHost

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.lua.conftest import Names

    MakeRig = Callable[..., Rig]

SCRIPT = lua_folder() / "echowing_speed.lua"
PILOT_MPS = 10.0
NO_DATA, LOW, HIGH, GOOD = 1, 2, 3, 4
SEARCHING, TRACKING, TOO_CLOSE, NO_SONAR, STREAM_LOST, BACKING_OFF = range(1, 7)
SLOWEST_MPS = pytest.approx(0.2)  # ECHO_SPD_MIN
FASTEST_MPS = 5.0  # ECHO_SPD_MAX
UNUSABLE = "damaged or impossible message, not used"
STEP_S = STEP_MS / 1000.0

# Thesis Figure 28: average in metres, speed assigned after it in cm/s, from 200 cm/s.
FIGURE_28 = [
    (3.080, 250),
    (2.622, 150),
    (2.916, 100),
    (3.104, 150),
    (3.09, 200),
    (3.102, 250),
    (2.45, 150),
    (3.591, 250),
    (3.916, 350),
    (6.08, 450),
    (3.636, 450),  # "Trim Airspeed is at Maximum"
    (2.37, 350),
    (3.234, 400),
    (0.79, 300),
    (3.488, 400),
]


@pytest.fixture
def rig(names: Names) -> MakeRig:
    """Makes a rig with the speed applet: `rig(LAW=1)` with those parameters."""

    def make(**applet: float) -> Rig:
        r = Rig(names, SCRIPT, **applet)
        r.raw_every_ms = 100
        return r

    return make


def float32(value: float) -> float:
    return float(struct.unpack("f", struct.pack("f", value))[0])


def next_below(value: float) -> float:
    """The 32-bit float just below a 32-bit float."""
    bits = struct.unpack("I", struct.pack("f", value))[0]
    return float(struct.unpack("f", struct.pack("I", bits - 1))[0])


# ---- the laws -----


def test_figure_28_sequence(rig: MakeRig) -> None:
    step = rig(LAW=0).run(0.3).host.local_value("law_step")
    speed_mps = 2.0
    for average_m, assigned_cmps in FIGURE_28:
        speed_mps = step(speed_mps, average_m)
        assert speed_mps * 100 == assigned_cmps, average_m


def test_thesis_reaches_50_to_450_and_refuses_0_and_500(rig: MakeRig) -> None:
    step = rig(LAW=0).run(0.3).host.local_value("law_step")
    assert [step(v, 4.0) for v in (3.5, 4.0, 4.5)] == [4.5, 4.0, 4.5]  # 5.0 is refused
    assert [step(v, 3.1) for v in (4.0, 4.5)] == [4.5, 4.5]
    assert [step(v, 2.0) for v in (2.0, 1.5, 1.0, 0.5)] == [1.0, 0.5, 1.0, 0.5]  # 0 is refused
    assert [step(v, 2.8) for v in (1.0, 0.5)] == [0.5, 0.5]
    assert step(2.3, 3.0) == float32(2.3)


def test_bands_stop_at_the_limits_instead(rig: MakeRig) -> None:
    step = rig(LAW=1).run(0.3).host.local_value("law_step")
    assert [step(v, 4.0) for v in (3.5, 4.5)] == [4.5, 5.0]
    assert [step(v, 2.0) for v in (2.0, 1.0)] == [1.0, float32(0.2)]


# Table 6, edge in metres -> change of speed at the edge and just below it
EDGES = [(3.25, 1.0, 0.5), (3.05, 0.5, 0.0), (2.95, 0.0, -0.5), (2.75, -0.5, -1.0)]


@pytest.mark.parametrize(("edge_m", "at", "below"), EDGES)
def test_band_edges_of_the_law_in_32_bit_floats(
    rig: MakeRig, edge_m: float, at: float, below: float
) -> None:
    step = rig(LAW=0).run(0.3).host.local_value("law_step")
    assert step(2.0, edge_m) - 2.0 == at
    assert step(2.0, next_below(float32(edge_m))) - 2.0 == below


def one_step(r: Rig, range_m: float) -> float:
    """Change of the limit by one step of the law: they come at 0.55, 1.0, 1.45, 1.9 s."""
    r.raw_every_ms = None  # a step of the range is no closing speed
    r.range(3.0).run(1.2)
    before = r.speed_mps
    r.range(range_m).run(0.5)
    return r.speed_mps - before


@pytest.mark.parametrize(("edge_m", "at", "below"), EDGES)
def test_band_edges_through_the_rangefinder(
    rig: MakeRig, edge_m: float, at: float, below: float
) -> None:
    """As the autopilot makes the range from the wire's centimetres: times 0.01 in 32 bits.

    In the older generation the range comes back as cut-off centimetres.
    """
    on_the_wire = round(edge_m * 100)
    for centimetres, change in ((on_the_wire, at), (on_the_wire - 1, below)):
        metres = float32(centimetres * float32(0.01))
        assert one_step(rig(LAW=0), metres) == change, centimetres


@pytest.mark.parametrize("law", [0, 1])
def test_at_exactly_the_detection_limit_it_searches(rig: MakeRig, law: int) -> None:
    assert one_step(rig(LAW=law, RATE=0), 4.5) == 0.0
    assert one_step(rig(LAW=law, RATE=0), 4.49) == 1.0


def test_wanted_distance_moves_the_bands(rig: MakeRig) -> None:
    step = rig(LAW=0, DIST=4.0).run(0.3).host.local_value("law_step")
    assert [step(2.0, m) for m in (4.3, 4.1, 4.0, 3.9, 3.7)] == [3.0, 2.5, 2.0, 1.5, 1.0]


def test_distances_are_between_the_vehicles_centres(rig: MakeRig) -> None:
    assert one_step(rig(LAW=0, INSET=0.2), 2.8) == 0.0
    assert one_step(rig(LAW=0, INSET=0.2), 3.0) == 0.5


def steps(r: Rig) -> list[tuple[int, float]]:
    """Time (ms, 50 a value: one an update) and value of each change of the limit."""
    speeds = r.vehicle.desired_speeds
    return [(50 * i, v) for i, v in enumerate(speeds) if i == 0 or v != speeds[i - 1]]


def test_thesis_steps_every_450_ms(rig: MakeRig) -> None:
    r = rig(LAW=0).range(3.6).run(5.0)
    changes_ms = steps(r)
    assert [mps for _, mps in changes_ms] == [2.5, 3.5, 4.5]
    # an update lasts 50 ms, so a period ends with the update at or after it
    assert changes_ms[2][0] - changes_ms[1][0] == 450


def test_thesis_keeps_its_speed_for_ever_while_searching(rig: MakeRig) -> None:
    """The dead-lock of the thesis: repelled to 0.5 m/s, then the leader is out of range."""
    r = rig(LAW=0).range(2.0).run(3.0)
    assert r.speed_mps == 0.5
    r.range(7.0, HIGH).run(60.0)
    assert r.speed_mps == 0.5
    assert r.state == SEARCHING


def test_law_1_recovers_once_the_target_is_lost(rig: MakeRig) -> None:
    r = rig(LAW=1).range(2.0).run(3.0)
    low = r.speed_mps
    assert low < 1.0
    r.range(7.0, HIGH).run(1.4)
    assert r.speed_mps == low
    r.run(1.2)
    assert r.speed_mps == 3.0  # ECHO_SPD_LOST
    assert r.texts[-1] == "searching"


@pytest.mark.parametrize("law", [0, 1])
def test_silent_sonar_means_the_speed_without_sonar(rig: MakeRig, law: int) -> None:
    r = rig(LAW=law, SPD_LOST=1.5).range(3.2).run(3.0)
    before = r.speed_mps
    r.no_data().run(1.4)
    assert r.speed_mps == before > 1.5
    r.run(2.0)
    assert r.speed_mps == 1.5
    assert r.texts.count("no sonar data") == 1
    assert r.mirror_mps == PILOT_MPS  # still in control: the pilot's value waits


@pytest.mark.parametrize(("range_m", "sign"), [(4.0, 1), (2.6, -1)])
def test_rate_limit_of_law_1_holds_both_ways(rig: MakeRig, range_m: float, sign: int) -> None:
    """Steps of 1 m/s every 0.45 s ask for more than 2 m/s2: 0.1 m/s each update, no more."""
    r = rig(LAW=1, RATE=2.0)
    r.raw_every_ms = None  # a step of the range is no closing speed
    r.range(3.0).run(2.0)
    before = len(r.vehicle.desired_speeds)
    r.range(range_m).run(1.4)
    speeds = r.vehicle.desired_speeds[before:]
    found = [b - a for a, b in pairwise(speeds)]
    assert max(sign * change for change in found) == pytest.approx(0.1, abs=1e-6)
    assert min(sign * change for change in found) >= 0.0


@pytest.mark.parametrize(("metres", "status"), [(math.nan, GOOD), (-2.0, GOOD), (0.0, GOOD)])
def test_ranges_that_are_none_change_nothing(rig: MakeRig, metres: float, status: int) -> None:
    r = rig(LAW=1).range(3.0).run(2.0)
    r.range(metres, status).run(1.0)
    assert r.speed_mps == 2.5


# ---- the guard -----


def close_in(r: Rig, from_m: float, closing_mps: float, to_m: float) -> None:
    """The range shrinks steadily, from one that is long known."""
    change(r.range(from_m).run(1.5), to_m, closing_mps)


def change(r: Rig, to_m: float, mps: float) -> Rig:
    """The range goes on steadily from what it was."""
    from_m = r.raw_m
    steps_count = round(abs(to_m - from_m) / (mps * STEP_S))
    for i in range(1, steps_count + 1):
        r.range(from_m + (to_m - from_m) * i / steps_count).step()
    return r


@pytest.mark.parametrize("law", [0, 1])
def test_too_fast_to_stop_it_backs_off(rig: MakeRig, law: int) -> None:
    """At 1.5 m/s: 1.5 x 1.2 s + 1.5^2 / 5 = 2.25 m to a stop: too little is left under 3.75 m."""
    r = rig(LAW=law, DIST=2.0)
    close_in(r, 4.4, 1.5, 3.85)
    assert r.vehicle.targets == []
    change(r, 3.2, 1.5)
    assert r.target_ahead_m() < -0.4
    assert r.speed_mps == FASTEST_MPS  # free to get away
    assert r.state == BACKING_OFF
    assert "too close, backing off" in r.texts


def test_too_near_it_backs_off_until_it_is_not(rig: MakeRig) -> None:
    """Its target is at the wanted distance; 0.3 m clear of "too close" the law has it again."""
    r = rig(LAW=1).range(2.0).run(2.0)
    assert r.vehicle.targets == []
    r.range(1.3).run(2.0)
    assert r.target_ahead_m() == pytest.approx(-1.7, abs=0.1)  # 3 m are wanted
    assert backs_off(change(r, 1.7, 0.2).run(0.5))  # ECHO_CLOSE is 1.5 m
    assert not backs_off(change(r, 1.9, 0.2).run(0.5))
    assert r.state == TRACKING


def test_from_a_leader_that_comes_it_backs_off_to_the_wanted_distance(rig: MakeRig) -> None:
    """It would begin anew from nearer, its nose and its sonar down."""
    r = rig(LAW=1)
    close_in(r, 4.4, 1.5, 2.6)  # this vehicle stands
    r.vehicle.velocity = (-1.5, 0.0, 0.0)  # now it is as fast as the leader: the distance stays
    assert backs_off(r.run(1.0))
    r.vehicle.velocity = (-2.0, 0.0, 0.0)
    assert not backs_off(change(r, 3.1, 0.5).run(0.5))


def backs_off(r: Rig) -> bool:
    """Whether the next half second brings targets away from the leader."""
    before = len(r.vehicle.targets)
    r.run(0.5)
    return len(r.vehicle.targets) > before


def read_once(r: Rig, *ranges_m: float) -> None:
    """These readings instead of the next ones, one each 0.1 s."""
    every_ms, r.raw_every_ms = r.raw_every_ms, None
    for range_m in ranges_m:
        r.run(0.1 - STEP_S)
        r.send_raw(range_m)
        r.step()
    r.raw_every_ms = every_ms


@pytest.mark.parametrize("seen", [True, False], ids=["known leader", "no leader"])
def test_the_third_wild_reading_alike_is_believed(rig: MakeRig, *, seen: bool) -> None:
    """Propellers make single wild ones, late echoes of the ground make two alike."""
    r = rig(LAW=1).range(3.0 if seen else 7.66, GOOD if seen else HIGH)
    r.run(2.0)
    for wild in ([1.0], [1.0, 1.1], [0.6, 1.2, 0.6], [1.0, 1.1, 1.7]):
        read_once(r, *wild)
        assert not backs_off(r), wild
    r.raw_every_ms = None
    read_once(r, 1.0, 1.1, 1.0)
    assert backs_off(r)


def test_wild_readings_that_are_far_apart_are_not_alike(rig: MakeRig) -> None:
    r = rig(LAW=1).range(7.66, HIGH).run(2.0)
    r.raw_every_ms = None
    for _ in range(10):
        read_once(r, 1.0)
        r.run(0.5)
    assert r.vehicle.targets == []


def test_own_braking_ends_it_while_the_sonar_sees_nothing(rig: MakeRig) -> None:
    """Its nose is up as it brakes: it is slower than the leader before it sees it again."""
    r = rig(LAW=0)
    r.vehicle.velocity = (3.5, 0.0, 0.0)  # 1.5 m/s faster than the leader
    close_in(r, 4.4, 1.5, 3.2)
    assert r.state == BACKING_OFF
    r.range(7.66, HIGH)
    assert backs_off(r)
    r.vehicle.velocity = (1.5, 0.0, 0.0)
    r.run(0.1)
    assert not backs_off(r)


@pytest.mark.parametrize("mps", [math.nan, math.inf, 1e30, -1e30])
def test_a_velocity_that_is_none_is_not_used(rig: MakeRig, mps: float) -> None:
    r = rig(LAW=1).range(3.0).run(2.0)
    r.vehicle.velocity = (mps, 0.0, 0.0)
    r.run(1.0)
    r.vehicle.velocity = (0.0, 0.0, 0.0)
    r.run(1.0)
    assert r.vehicle.targets == []
    assert r.state == TRACKING
    assert backs_off(r.range(1.2).run(0.5))


def test_without_a_velocity_it_still_backs_off(rig: MakeRig) -> None:
    r = rig(LAW=1).range(3.0)
    r.vehicle.velocity = None
    r.run(2.0)
    assert r.vehicle.targets == []
    assert backs_off(r.range(1.2).run(0.5))


def test_readings_a_millisecond_apart_are_no_speed(rig: MakeRig) -> None:
    """A leader does not come faster than the highest speed, ECHO_SPD_MAX."""
    r = rig(LAW=1).range(3.0).run(2.0)
    r.raw_every_ms = None
    r.send_raw(3.0)
    r.send_raw(2.9, board_ms=r.vehicle.t_ms + 1)
    r.run(0.1)
    assert r.host.local_value("S")["leader_mps"] == -FASTEST_MPS


def test_backs_off_along_the_heading(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.yaw = math.pi / 2  # facing east: back is west
    r.range(3.0).run(2.0)
    r.range(1.2).run(1.0)
    kind, (north_m, east_m, down_m, yaw_rad) = r.vehicle.targets[-1]
    assert kind == "position"
    assert north_m == pytest.approx(0.0, abs=1e-3)
    assert float(east_m or 0.0) < -1.5
    assert down_m == -10.0
    assert yaw_rad == pytest.approx(math.pi / 2)  # the sonar keeps looking at the leader


@pytest.mark.parametrize(("height_m", "backs_off"), [(1.4, False), (1.6, True)])
def test_what_is_near_in_a_take_off_is_the_ground(
    rig: MakeRig, height_m: float, *, backs_off: bool
) -> None:
    r = rig(LAW=1)
    r.vehicle.height_m = height_m
    r.range(3.0).run(2.0)
    r.range(1.2).run(1.0)
    assert bool(r.vehicle.targets) is backs_off
    if not backs_off:
        assert r.speed_mps == SLOWEST_MPS
        assert r.state == TOO_CLOSE


def test_a_leader_lost_while_near_is_near(rig: MakeRig) -> None:
    """While it backs off its nose is up, and the sonar often sees nothing."""
    r = rig(LAW=1).range(3.0).run(2.0)
    r.range(1.2).run(1.0)
    r.range(7.66, HIGH).run(2.0)
    targets = len(r.vehicle.targets)
    r.run(0.3)
    assert len(r.vehicle.targets) > targets
    r.run(1.5)
    targets = len(r.vehicle.targets)
    r.run(0.5)
    assert len(r.vehicle.targets) == targets


def test_out_of_range_low_is_too_close(rig: MakeRig) -> None:
    r = rig(LAW=1).range(3.0).run(2.0)
    r.range(0.0, LOW).run(0.3)  # whatever the number says
    assert r.speed_mps in (SLOWEST_MPS, FASTEST_MPS)
    assert r.state in (TOO_CLOSE, BACKING_OFF)


# ---- the stream -----


def point(lat: int = round(HERE[0] * 1e7), system: int = 1) -> bytes:
    fields = (lat, round(HERE[1] * 1e7), 10.0, *(0.0,) * 8, POSITION_ONLY, system, 1, 6)
    return struct.pack("<Iii9fHBBB", 0, *fields)


def streamed(r: Rig, seconds: float = 3.0, system: int = 1, sender: int = GROUND_TOOL) -> Rig:
    for _ in range(round(seconds / 0.12)):
        r.vehicle.inbox.append((mavlink_frame(86, point(system=system), sender), 0))
        r.run(0.12)
    return r


@pytest.mark.parametrize("old", [False, True], ids=["MAVLink 2", "MAVLink 1"])
def test_holds_where_it_is_when_the_stream_falls_silent(rig: MakeRig, *, old: bool) -> None:
    r = rig(LAW=1).range(3.0)
    for _ in range(20):
        r.vehicle.inbox.append((mavlink_frame(86, point(), GROUND_TOOL, old=old), 0))
        r.run(0.12)
    r.run(0.8)
    assert r.vehicle.targets == []
    r.run(0.4)
    assert len(r.vehicle.targets) == 1
    assert r.target_ahead_m() == pytest.approx(0.0, abs=0.02)
    assert r.vehicle.mode == 4
    assert r.texts[-1] == "stream lost, holding here"
    assert r.run(1.0).state == STREAM_LOST
    assert len(r.vehicle.targets) == 1  # told once, it stays
    assert streamed(r, 1.0).state == TRACKING


@pytest.mark.parametrize(
    "what", [{"system": 9}, {"seconds": 0.12}, {"seconds": 0.24}], ids=["another's", "one", "two"]
)
def test_what_is_no_stream_for_it_is_not_watched(rig: MakeRig, what: dict[str, float]) -> None:
    r = streamed(rig(LAW=1).range(3.0).run(1.0), **what)  # type: ignore[arg-type]
    assert r.run(5.0).vehicle.targets == []


def test_watchdog_can_be_turned_off(rig: MakeRig) -> None:
    assert streamed(rig(LAW=1, STREAM_T=0).range(3.0)).run(5.0).vehicle.targets == []


def test_hold_is_repeated_until_it_is_accepted(rig: MakeRig) -> None:
    r = streamed(rig(LAW=1).range(3.0))
    r.vehicle.position = None
    assert r.run(2.0).vehicle.targets == []
    r.vehicle.position = (0.0, 0.0, -10.0)
    assert len(r.run(0.2).vehicle.targets) == 1


def test_damaged_points_are_no_stream(rig: MakeRig) -> None:
    """Every byte of the frame changed once: none keeps the watch quiet."""
    r = streamed(rig(LAW=1).range(3.0))
    whole = mavlink_frame(86, point(), GROUND_TOOL)
    for place in range(1, len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        r.vehicle.inbox.append((bytes(damaged), 0))
        r.run(0.05)
    assert r.state == STREAM_LOST
    assert len(r.vehicle.targets) == 1
    assert r.texts.count(UNUSABLE) == 1
    # All but its id's, which are another message's: the autopilot does not hand that over.
    assert r.vehicle.named["ECHO_REF"][-1] >= len(whole) - 4


@pytest.mark.parametrize("range_m", [math.nan, -math.inf, 0.0, -1.0])
def test_an_impossible_reading_is_counted_and_told_once(rig: MakeRig, range_m: float) -> None:
    r = rig(LAW=1).range(3.0).run(1.0)
    near_m = r.host.local_value("S")["near_m"]
    r.raw_every_ms = None
    for number in range(4):
        reading = struct.pack("<If10s", r.vehicle.t_ms + number, range_m, b"SNR_RAW")
        r.vehicle.inbox.append((mavlink_frame(251, reading, CO_PROCESSOR), 0))
    r.run(0.6)
    assert r.host.local_value("S")["near_m"] == near_m
    assert r.texts.count(UNUSABLE) == 1
    assert r.vehicle.named["ECHO_REF"][-1] == 4


def test_points_of_a_second_sender_do_not_count(rig: MakeRig) -> None:
    r = streamed(rig(LAW=1).range(3.0))
    streamed(r, 0.9, sender=99)  # the first is not yet gone
    r.run(0.3)
    assert r.state == STREAM_LOST
    assert r.texts.count("points of a second sender, not used") == 1
    assert r.vehicle.named["ECHO_REF"][-1] > 3
    assert streamed(r, 1.0, sender=99).state == TRACKING  # it is gone


# ---- control -----


def test_writes_parameter_and_limit_at_every_update(rig: MakeRig) -> None:
    r = rig(LAW=1).range(3.0).run(2.0)
    assert len(r.vehicle.desired_speeds) >= 35  # 20 a second once it is ready
    assert r.parameter_mps == r.speed_mps == 2.5  # ECHO_SPD_INIT
    assert r.names.speed not in r.vehicle.saved


LEAVE: dict[str, Callable[[Rig], None]] = {
    "mode": lambda r: setattr(r.vehicle, "mode", 5),
    "disarmed": lambda r: setattr(r.vehicle, "is_armed", False),
    "disabled": lambda r: r.vehicle.parameters.update(ECHO_ENABLE=0.0),
}


@pytest.mark.parametrize("why", LEAVE)
def test_hands_the_pilots_value_back(rig: MakeRig, why: str) -> None:
    r = rig(LAW=1).range(2.0).run(3.0)
    assert r.parameter_mps < 1.0
    assert r.mirror_mps == PILOT_MPS
    LEAVE[why](r)
    r.run(2.0 if why == "disabled" else 0.3)
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0
    pilots = f"{PILOT_MPS * r.names.units_per_mps:.2f}"
    assert r.texts[-1] == f"handed back, {r.names.speed} {pilots} ({why})"
    writes = len(r.vehicle.desired_speeds)
    r.run(2.0)
    assert len(r.vehicle.desired_speeds) == writes  # hands off


@pytest.mark.parametrize(("enable", "armed", "mode"), [(0, True, 4), (1, False, 4), (1, True, 5)])
def test_acts_only_enabled_armed_and_in_guided(
    rig: MakeRig, enable: int, armed: bool, mode: int
) -> None:
    r = rig(ENABLE=enable)
    r.vehicle.is_armed, r.vehicle.mode = armed, mode
    r.range(2.0).run(3.0)
    assert r.vehicle.desired_speeds == []
    assert r.parameter_mps == PILOT_MPS


def test_pilot_may_change_the_speed_parameter_in_flight(rig: MakeRig) -> None:
    r = rig(LAW=1).range(3.0).run(2.0)
    r.vehicle.parameters[r.names.speed] = 7.0 * r.names.units_per_mps
    r.run(0.5)
    assert r.parameter_mps == r.speed_mps == 2.5
    assert r.mirror_mps == 7.0
    r.vehicle.parameters[r.names.speed] = 6.0 * r.names.units_per_mps
    r.vehicle.mode = 5  # in the same moment
    r.run(0.5)
    assert r.parameter_mps == 6.0


@pytest.mark.parametrize("pilots_mps", [math.nan, math.inf, -1.0, 0.0, 51.0])
def test_does_not_act_with_a_speed_parameter_that_is_no_speed(
    rig: MakeRig, pilots_mps: float
) -> None:
    """It could not give it back."""
    r = rig(LAW=1).range(3.0)
    r.vehicle.parameters[r.names.speed] = pilots_mps * r.names.units_per_mps
    r.run(2.0)
    assert r.vehicle.desired_speeds == []
    assert r.texts == ["ready"]
    assert r.mirror_mps == 0.0
    r.vehicle.parameters[r.names.speed] = 5.0 * r.names.units_per_mps
    assert r.run(1.0).vehicle.desired_speeds != []


def test_a_speed_that_is_none_is_not_the_pilots(rig: MakeRig) -> None:
    r = rig(LAW=1).range(3.0).run(1.0)
    for mps in (math.nan, math.inf, -1.0, 51.0):
        r.vehicle.parameters[r.names.speed] = mps * r.names.units_per_mps
        r.run(0.5)
    r.vehicle.mode = 5
    r.run(0.5)
    assert r.parameter_mps == PILOT_MPS


def test_restarted_script_restores_the_pilots_value(rig: MakeRig) -> None:
    r = rig(LAW=1).range(2.0).run(3.0)
    assert r.parameter_mps < 1.0
    r.restart_script()
    r.vehicle.mode = 5
    r.run(0.1)
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0
    assert "restarted" in "".join(r.texts)


@pytest.mark.parametrize("instructions", [*range(1, 800, 37)])
def test_killed_anywhere_in_an_update_the_pilots_value_survives(
    rig: MakeRig, instructions: int
) -> None:
    r = rig(LAW=1).range(2.0).run(1.0)
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


def test_an_error_is_told_once_with_its_place_and_hands_back(rig: MakeRig) -> None:
    r = rig(LAW=1).range(2.0).run(3.0)
    r.host.local_value("S")["near_m"] = "x"  # as a bug would: arithmetic on a word
    r.run(5.0)
    errors = [text for text in r.texts if text.startswith("error")]
    assert len(errors) == 1
    assert "scripts/echowing_speed.lua:" in errors[0]
    assert any("(error)" in text for text in r.texts)
    assert r.parameter_mps == PILOT_MPS
    assert r.mirror_mps == 0.0
    r.host.local_value("S")["near_m"] = 2.0
    r.run(3.0)
    assert r.parameter_mps < PILOT_MPS  # it tried again


def test_stops_when_its_parameter_key_is_taken(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.tables[95] = "OTHER_"
    for t_ms in (10, 20):
        r.vehicle.t_ms = t_ms
        r.host.step(t_ms)
    assert "parameter table key 95 is taken" in str(r.host.error)


def test_may_not_arm_without_a_forward_rangefinder(rig: MakeRig) -> None:
    for ranges, enable, reason in (
        ({0: (GOOD, 3.0)}, 1, None),
        ({25: (GOOD, 3.0)}, 1, "ECHO: no forward rangefinder"),
        ({25: (GOOD, 3.0)}, 0, None),
    ):
        r = rig(ENABLE=enable)
        r.vehicle.is_armed, r.vehicle.ranges = False, ranges
        r.run(2.5)
        assert list(r.vehicle.auth.values()) == [reason]


def test_wrong_values_are_told_and_do_not_count(rig: MakeRig) -> None:
    r = rig(SPD_MIN=0.0, LAW=1).range(2.0).run(4.0)
    assert min(r.vehicle.desired_speeds) == SLOWEST_MPS
    assert r.texts.count("ECHO_SPD_MIN out of range, using 0.20") == 1
    r.vehicle.parameters["ECHO_SPD_MAX"] = math.nan
    r.run(2.0)
    assert r.texts.count("ECHO_SPD_MAX out of range, using 5.00") == 1


def test_an_update_with_a_full_queue_stays_below_the_limit(rig: MakeRig) -> None:
    r = rig(LAW=1)
    r.host = LuaHost(r.vehicle, SCRIPT, generation=r.names.generation, count_instructions=True)
    r.range(3.0).run(1.0)
    worst = 0
    for i in range(100):
        if i % 10 == 0:
            r.vehicle.inbox.extend((mavlink_frame(86, point(), GROUND_TOOL), 0) for _ in range(5))
        r.range(1.2 if i > 50 else 3.0).step()
        worst = max(worst, r.host.instructions)
    assert 100 < worst < 4000  # of the 10000 of SCR_VM_I_COUNT


def test_named_floats_and_texts(rig: MakeRig) -> None:
    r = rig(LAW=1).range(3.0).run(10.0)
    named = r.vehicle.named
    assert set(named) == {"ECHO_RNG", "ECHO_SPD", "ECHO_STATE", "ECHO_REF"}
    assert named["ECHO_RNG"][-1] == 3.0
    assert named["ECHO_SPD"][-1] == r.speed_mps
    assert 18 <= len(named["ECHO_RNG"]) <= 21  # 2 a second
    assert r.texts == ["ready", "in control, law 1, 2.5 m/s"]
    for _ in range(30):
        r.range(7.0, HIGH).run(2.0)
        r.range(3.0).run(2.0)
    assert len(r.texts) < 16  # 30 losses in 120 s: each state at most every 10 s


@pytest.mark.parametrize("places", [1, 2])
def test_without_a_place_to_receive_it_lives_and_may_not_arm(rig: MakeRig, places: int) -> None:
    """Another script was there first: it has all the places, or left one."""
    r = rig()
    r.host._inbox.init(5, places)
    r.host._inbox.register(33)
    r.vehicle.is_armed = False
    r.run(2.5)
    assert r.host.running
    assert r.texts == [NO_PLACE]
    assert list(r.vehicle.auth.values()) == [f"ECHO: {NO_PLACE}"]
    r.vehicle.is_armed = True  # forced
    r.range(2.0).run(2.0)
    assert r.host.running
    assert r.vehicle.desired_speeds == []


# ---- its table -----


def test_numbers_belong_to_names_in_both_applets(rig: MakeRig) -> None:
    """The autopilot keeps saved values by number: the other applet's DIST is this one's DIST."""
    numbers: dict[str, int] = {}
    for script in (SCRIPT, lua_folder() / "echowing.lua"):
        vehicle = Rig(rig().names, script).run(0.1).vehicle
        for name, number in vehicle.numbers.items():
            assert numbers.setdefault(name, number) == number, name
    assert len(set(numbers.values())) == len(numbers)


def test_parameter_names_fit_and_are_documented() -> None:
    source = SCRIPT.read_text(encoding="utf-8")
    documented = [line.split()[-1] for line in source.splitlines() if "// @Param:" in line]
    assert len(documented) == len(set(documented)) == 21
    assert all(len(name) <= 16 for name in documented)
    for field in ("@DisplayName", "@Description", "@User"):
        assert source.count(f"// {field}:") == len(documented)
    page = SCRIPT.with_suffix(".md").read_text(encoding="utf-8")
    assert [name for name in documented if f"| `{name}` |" not in page] == []
    for text in (*TEXTS, "ready", "in control", "handed back", "restarted", "out of range, using"):
        assert text in page, text


NO_PLACE = "other scripts leave no place to receive"
TEXTS = (
    *("searching", "tracking", "too close", "no sonar data", "stream lost, holding here"),
    *("too close, backing off", "parameter table key 95 is taken", "no forward rangefinder"),
    NO_PLACE,
)
