"""The speed laws: thesis figures to the digit, band edges through 32-bit floats, stability."""

from __future__ import annotations

import cmath
import math
import struct
import tomllib
from collections import deque
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.lua.conftest import MakeRig, Rig

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


VECTORS = tomllib.loads(
    (Path(__file__).parents[1] / "flight" / "envelope.toml").read_text(encoding="utf-8")
)


def float32(value: float) -> float:
    return float(struct.unpack("f", struct.pack("f", value))[0])


def next_below(value: float) -> float:
    """The 32-bit float just below a 32-bit float."""
    bits = struct.unpack("I", struct.pack("f", value))[0]
    return float(struct.unpack("f", struct.pack("I", bits - 1))[0])


def test_figure_28_sequence(rig: MakeRig) -> None:
    step = rig(LAW=0).run(0.1).host.local_value("thesis_step")
    speed_mps = 2.0
    for average_m, assigned_cmps in FIGURE_28:
        speed_mps = step(speed_mps, average_m)
        assert speed_mps * 100 == assigned_cmps, average_m


def test_thesis_reaches_50_to_450_and_refuses_0_and_500(rig: MakeRig) -> None:
    step = rig(LAW=0).run(0.1).host.local_value("thesis_step")
    assert [step(v, 4.0) for v in (3.5, 4.0, 4.5)] == [4.5, 4.0, 4.5]  # 5.0 is refused
    assert [step(v, 3.1) for v in (4.0, 4.5)] == [4.5, 4.5]
    assert [step(v, 2.0) for v in (2.0, 1.5, 1.0, 0.5)] == [1.0, 0.5, 1.0, 0.5]  # 0 is refused
    assert [step(v, 2.8) for v in (1.0, 0.5)] == [0.5, 0.5]
    assert step(2.3, 3.0) == float32(2.3)


def test_bands_stop_at_the_limits_instead(rig: MakeRig) -> None:
    step = rig(LAW=1).run(0.1).host.local_value("band_step")
    assert [step(v, 4.0) for v in (3.5, 4.5)] == [4.5, 5.0]
    assert [step(v, 2.0) for v in (2.0, 1.0)] == [1.0, float32(0.2)]


# Table 6, edge in metres -> change of speed at the edge and just below it
EDGES = [(3.25, 1.0, 0.5), (3.05, 0.5, 0.0), (2.95, 0.0, -0.5), (2.75, -0.5, -1.0)]


@pytest.mark.parametrize(("edge_m", "at", "below"), EDGES)
def test_band_edges_of_the_law_in_32_bit_floats(
    rig: MakeRig, edge_m: float, at: float, below: float
) -> None:
    change = rig(LAW=0).run(0.1).host.local_value("band_change")
    assert change(edge_m) == at
    assert change(next_below(float32(edge_m))) == below


def one_step(r: Rig, range_m: float) -> float:
    """Change of the limit after one period of the law at a range."""
    r.vehicle.velocity = (2.5, 0.0, 0.0)  # as fast as the leader: nothing closes
    r.range(3.0).run(1.0)
    before = r.speed_mps
    r.range(range_m).run(0.55)
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


def test_cut_off_centimetres_and_metres_differ_only_inside_a_centimetre(rig: MakeRig) -> None:
    """No edge lies inside a centimetre, so both generations take the same step."""
    for metres, change in ((3.259, 1.0), (3.2499, 0.5), (3.0599, 0.5), (3.0499, 0.0)):
        assert one_step(rig(LAW=0), metres) == change, metres


@pytest.mark.parametrize("law", [0, 1])
def test_at_exactly_the_detection_limit_it_searches(rig: MakeRig, law: int) -> None:
    assert one_step(rig(LAW=law, RATE=0), 4.5) == 0.0
    assert one_step(rig(LAW=law, RATE=0), 4.49) == 1.0


def test_thesis_steps_every_450_ms(rig: MakeRig) -> None:
    r = rig(LAW=0).range(3.6).run(5.0)
    changes_ms = steps(r)
    assert [mps for _, mps in changes_ms] == [2.5, 3.5, 4.5]
    # an update lasts 50 ms, so a period ends with the update at or after it
    assert changes_ms[2][0] - changes_ms[1][0] == 450


def steps(r: Rig) -> list[tuple[int, float]]:
    """Time (ms, 50 a value: one an update) and value of each change of the limit."""
    speeds = r.vehicle.desired_speeds
    return [(50 * i, v) for i, v in enumerate(speeds) if i == 0 or v != speeds[i - 1]]


def test_thesis_keeps_its_speed_for_ever_while_searching(rig: MakeRig) -> None:
    """The dead-lock of ardupilot.md: repelled to 0.5 m/s, then the leader is out of range."""
    r = rig(LAW=0).range(2.0).run(3.0)
    assert r.speed_mps == 0.5
    r.range(7.0, status=3).run(60.0)
    assert r.speed_mps == 0.5


@pytest.mark.parametrize("law", [1, 2])
def test_speed_recovers_once_the_target_is_lost(rig: MakeRig, law: int) -> None:
    r = rig(LAW=law).range(2.0).run(3.0)
    low = r.speed_mps
    assert low < 1.0
    r.range(7.0, status=3).run(1.2)
    assert r.speed_mps == low
    r.run(1.0)
    assert r.speed_mps == 3.0  # ECHO_SPD_LOST
    assert r.texts[-1].startswith("searching")


def changes(r: Rig, range_m: float, seconds: float) -> list[float]:
    """Changes of the limit, one an update (50 ms), at a range behind a leader of the same speed."""
    r.vehicle.velocity = (2.5, 0.0, 0.0)
    before = len(r.vehicle.desired_speeds)
    r.range(range_m).run(seconds)
    return [b - a for a, b in pairwise(r.vehicle.desired_speeds[before - 1 :])]


@pytest.mark.parametrize(("range_m", "sign"), [(4.0, 1), (2.6, -1)])
def test_rate_limit_holds_both_ways(rig: MakeRig, range_m: float, sign: int) -> None:
    """Steps of 1 m/s every 0.45 s ask for more than 2 m/s^2: 0.1 m/s each update, no more."""
    r = rig(LAW=1, RATE=2.0)
    changes(r, 3.0, 2.0)
    assert r.speed_mps == 2.5
    assert changes(r, range_m, 1.0) == pytest.approx([sign * 0.1] * 20, abs=1e-6)


def test_rate_limit_holds_for_law_2(rig: MakeRig) -> None:
    r = rig(LAW=2, RATE=2.0)
    changes(r, 3.0, 2.0)
    found = changes(r, 4.0, 1.0)
    assert max(found) == pytest.approx(0.1, abs=1e-6)
    assert r.speed_mps == pytest.approx(2.5 + 0.7, abs=0.05)  # GAIN_P for the metre it is too far
    found = changes(r, 3.0, 1.0)
    assert min(found) == pytest.approx(-0.1, abs=1e-6)


@pytest.mark.parametrize("applet", [{"LAW": 1, "RATE": 0.0}, {"LAW": 0, "RATE": 2.0}])
def test_without_a_rate_limit_a_step_is_whole(rig: MakeRig, applet: dict[str, float]) -> None:
    r = rig(**applet)
    changes(r, 3.0, 2.0)
    assert max(changes(r, 4.0, 0.6)) == 1.0
    assert min(changes(r, 2.6, 0.6)) == -1.0


@pytest.mark.parametrize("one", VECTORS["closing"])
def test_stops_by_the_rule_of_the_ground_tools_envelope(
    rig: MakeRig, one: dict[str, float]
) -> None:
    r = rig(CLOSE=one["least_m"], DELAY=one["dead_s"], DECEL=one["decel_mps2"]).run(0.1)
    guard = r.host.local_value("guard")
    assert guard.stoppable_mps(one["certain_m"]) == pytest.approx(one["limit_mps"], abs=1e-3)


def test_wanted_distance_moves_the_bands(rig: MakeRig) -> None:
    change = rig(LAW=0, DIST=4.0).run(0.1).host.local_value("band_change")
    assert [change(m) for m in (4.3, 4.1, 4.0, 3.9, 3.7)] == [1.0, 0.5, 0.0, -0.5, -1.0]


# Law 2 in a loop with the vehicle as measured: 0.3 s dead time, 63 % of a step after 1.05 s
# (recording cap_steps), and the sonar: 1 cm steps, a reading each 50 or 100 ms, one period late.

DEAD_TIME_S = 0.3
LAG_S = 0.75
READING_S = 0.05  # the age that the applet gives a reading
LEADER_MPS = 1.5
FAR_M = 20.0


class Loop:
    """Leader ahead at a steady speed, a guided point always far ahead: the limit alone decides."""

    def __init__(self, r: Rig, range_m: float, reading_ms: int, *, averages: bool) -> None:
        self.rig, self.range_m, self.reading_ms = r, range_m, reading_ms
        self.averages = averages
        self.speed_mps = LEADER_MPS
        self.ranges: list[float] = []
        self._wishes: deque[float] = deque([LEADER_MPS] * round(DEAD_TIME_S * 100))
        self._readings: deque[float] = deque([round(range_m, 2)] * 10, maxlen=10)
        r.stream_every_ms = 120

    def step(self) -> None:
        r = self.rig
        if r.vehicle.t_ms % self.reading_ms == 0:
            self._sonar()
        r.vehicle.velocity = (self.speed_mps, 0.0, 0.0)
        r.step()
        self._wishes.append(self._wish())
        self.speed_mps += (self._wishes.popleft() - self.speed_mps) * 0.01 / LAG_S
        self.range_m += (LEADER_MPS - self.speed_mps) * 0.01
        self.ranges.append(self.range_m)

    def _wish(self) -> float:
        """Speed wanted: 1/s times the distance to the point in force, up to the limit."""
        vehicle = self.rig.vehicle
        if not vehicle.desired_speeds:
            return LEADER_MPS
        evading = bool(vehicle.targets)
        vehicle.targets = vehicle.targets[-1:] if vehicle.t_ms % 50 else []
        ahead_m = self.rig.target_ahead_m() if evading and vehicle.targets else FAR_M
        return max(-self.rig.speed_mps, min(self.rig.speed_mps, ahead_m))

    def _sonar(self) -> None:
        r = self.rig
        if not self.averages:
            r.send_raw(self._readings[-1])  # the reading before: one period old
        self._readings.append(round(self.range_m, 2))
        average_m = sum(self._readings) / len(self._readings)
        seen = average_m < 4.5
        r.vehicle.ranges[0] = (4 if seen else 3, average_m)


@pytest.mark.parametrize("reading_ms", [50, 100])
@pytest.mark.parametrize("start_m", [0.3, 0.6, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.4])
def test_continuous_law_settles_from_everywhere(
    rig: MakeRig, start_m: float, reading_ms: int
) -> None:
    loop = Loop(rig(LAW=2), start_m, reading_ms, averages=False)
    for _ in range(2500):
        loop.step()
    last = loop.ranges[-500:]
    assert max(abs(m - 3.0) for m in last) < 0.1
    assert max(last) - min(last) < 0.05  # no limit cycle
    # it starts 1 m/s too fast, for as long as three readings and the dead time last
    assert min(loop.ranges) > min(start_m, 3.0) - 0.3


@pytest.mark.parametrize("reading_ms", [50, 100])
def test_continuous_law_settles_on_averages_alone(rig: MakeRig, reading_ms: int) -> None:
    """No SNR_RAW: the average of ten readings, a quarter or half a second old, has to do."""
    loop = Loop(rig(LAW=2), 4.0, reading_ms, averages=True)
    for _ in range(3000):
        loop.step()
    assert max(abs(m - 3.0) for m in loop.ranges[-500:]) < 0.2


def margins(p: float, d: float, tau_s: float, delay_s: float) -> tuple[float, float]:
    """Phase margin in degrees and gain margin of law 2's loop, opened at the vehicle's answer.

    The law: limit = l + P (r - wanted) + D (l - own). Range r, leader speed l and acceleration a
    come from the observer s r = l - own + (3/T + 3 A/T^2) e, s l = a + (3/T^2) e, s a = e/T^3 of
    the error e = z + A (l - own) - r, with readings z that are `delay_s` old and counted as
    A = 0.05 s old.
    With z = -exp(-delay s) own / s all three follow from the own speed. The vehicle:
    exp(-0.3 s) / (1 + 0.75 s).
    """

    def loop(w: float) -> complex:
        s = 1j * w
        vehicle = cmath.exp(-DEAD_TIME_S * s) / (1 + LAG_S * s)
        late = cmath.exp(-delay_s * s)
        to_speed = 3.0 / (tau_s**2 * s) + 1.0 / (tau_s**3 * s**2)
        to_range = (3.0 / tau_s + READING_S * 3.0 / tau_s**2 + to_speed) / s
        error = ((1.0 - late) / s - READING_S) / (1.0 - READING_S * to_speed + to_range)
        leader, range_m = to_speed * error, to_range * error - 1.0 / s
        return -vehicle * (leader + p * range_m + d * (leader - 1.0))

    phase_margin, gain_margin, before = 360.0, math.inf, loop(0.05)
    w = 0.05
    while w < 30.0:
        w *= 1.01
        now = loop(w)
        if (abs(before) - 1) * (abs(now) - 1) <= 0:
            angle = math.degrees(math.atan2(now.imag, now.real))
            phase_margin = min(phase_margin, abs(angle + 180.0) % 360.0)
        if before.imag < 0 <= now.imag and now.real < 0:
            gain_margin = min(gain_margin, 1 / abs(now))
        before = now
    return phase_margin, gain_margin


@pytest.mark.parametrize("reading_s", [0.05, 0.1])
def test_gains_leave_margins_at_both_sonar_rates(rig: MakeRig, reading_s: float) -> None:
    table: Any = rig().run(0.1).host.local_value("C")
    phase, gain = margins(table.GAIN_P, table.GAIN_D, table.TAU, 1.5 * reading_s)
    assert phase > 50.0  # 67 and 62 degrees as written in the applet's doc
    assert gain > 2.5
