"""Hundreds of random flights of the applet, thousands in `make test-long`: what always holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytestmark = pytest.mark.seconds(10)

if TYPE_CHECKING:
    from tests.lua.conftest import MakeRig, Rig

FLOOR_MPS, HARD_CLOSE_M = 0.2, 1.0
DEFAULT_DETECT_M = 4.5
LOW, GOOD = 2, 4
SLACK = 1e-5  # 32-bit floats of metres a second
FORWARD_M, BACK_M = 1.0, 5.0
GENTLE_M = 0.2  # no target lies further ahead, wherever the point is
# A point is seen at the next update, 50 ms later: 3 m/s make 0.15 m; 1e-7 degrees are 0.01 m.
HELD_SLACK_M = 0.17
# What a leader that brakes as hard as a copter can (4 m/s2) adds: 0.3 s ahead of its lean.
BRAKING_M = 0.18

odd_numbers = st.sampled_from([math.nan, math.inf, -math.inf, -1.0, 0.0, 1e9])
metres = st.floats(0.05, 8.0) | odd_numbers
applet_values = st.floats(-2.0, 20.0) | odd_numbers
APPLET = ["DIST", "CLOSE", "SPD_MIN", "SPD_MAX", "SPD_LOST", "DELAY", "STREAM_T"]

actions = st.one_of(
    st.tuples(st.just("range"), metres, st.sampled_from([0, 1, LOW, 3, GOOD, GOOD, GOOD])),
    st.tuples(st.just("raw"), metres),
    st.tuples(st.just("set"), st.just("mode"), st.sampled_from([4, 4, 4, 0, 3, 5, 6])),
    st.tuples(st.just("set"), st.just("is_armed"), st.sampled_from([True, True, False])),
    st.tuples(st.just("switch"), st.sampled_from([2, 2, 1, 0, None])),
    st.tuples(st.just("target"), st.floats(-8.0, 8.0), st.none() | st.floats(-3.0, 3.0)),
    st.tuples(st.just("held"), st.floats(-8.0, 8.0), st.floats(-3.0, 3.0), st.floats(0.3, 4.4)),
    st.tuples(st.just("velocity"), st.floats(-4.0, 4.0) | odd_numbers),
    st.tuples(st.just("set"), st.just("place"), st.sampled_from([(39.34, -86.03, 260.0), None])),
    st.tuples(st.just("applet"), st.sampled_from(APPLET), applet_values),
    st.tuples(st.just("restart")),
    st.tuples(st.just("wait"), st.floats(0.05, 1.0)),
)


class Watch:
    """Acts on the rig and checks after every step."""

    def __init__(self, r: Rig) -> None:
        self.r = r
        self.behind_ms = -(10**6)
        self.streamed = (0.0, 0.0, 0)  # metres ahead, m/s, when (ms): the newest point
        self.heard = 0
        self.tables: tuple[Any, ...] | None = None

    def do(self, action: tuple[Any, ...]) -> None:
        r, vehicle = self.r, self.r.vehicle
        match action:
            case ("range", value, status):
                vehicle.ranges[0] = (status, value)
            case ("raw", value):
                r.send_raw(value)
            case ("set", name, value):
                setattr(vehicle, name, value)
            case ("switch", None):
                vehicle.switches.clear()
            case ("switch", position):
                vehicle.switches[300] = position
            case ("target", ahead_m, velocity_mps):
                self.stream(ahead_m, velocity_mps)
            case ("held", ahead_m, velocity_mps, range_m):
                vehicle.ranges[0] = (GOOD, range_m)
                for _ in range(5):
                    self.stream(ahead_m, velocity_mps)
                    self.wait(2)
            case ("velocity", north_mps):
                vehicle.velocity = (north_mps, 0.0, 0.0)
            case ("applet", name, value):
                vehicle.parameters[f"ECHO_{name}"] = value
            case ("restart",):
                r.restart_script()
                self.tables = None
            case ("wait", seconds):
                self.wait(round(seconds * 20))
        self.wait(1)

    def stream(self, ahead_m: float, velocity_mps: float | None) -> None:
        self.r.send_target(ahead_m, velocity_mps)
        if velocity_mps is None:  # not a point of the hold's
            return
        self.streamed = ahead_m, velocity_mps, self.r.vehicle.t_ms
        if ahead_m < 0.0:
            self.behind_ms = self.r.vehicle.t_ms

    def wait(self, updates: int) -> None:
        for _ in range(updates):
            self.r.vehicle.t_ms += 50
            self.r.host.step(self.r.vehicle.t_ms)
            self.check()

    def check(self) -> None:
        r = self.r
        assert r.host.error is None, r.host.error
        self.check_texts()
        if self.tables is None and r.host.local_value("control") is not None:
            names = ("control", "guard", "hold", "C", "track", "own", "stream")
            self.tables = tuple(map(r.host.local_value, names))
        if self.tables is None:  # restarted, and not yet run
            return
        control, guard, hold, limits, track, own, stream = self.tables
        if not control.active:
            assert r.parameter_mps == pytest.approx(10.0)
            assert r.mirror_mps == 0.0
            return
        low, high = limits.SPD_MIN, limits.SPD_MAX
        assert FLOOR_MPS - SLACK <= low - SLACK <= r.speed_mps <= high + SLACK
        assert r.parameter_mps == pytest.approx(r.speed_mps, abs=SLACK)
        assert r.mirror_mps == pytest.approx(10.0)
        if hold.active and not stream.holding:  # points have not fallen silent
            self.check_held()
        elif hold.is_wanted() and r.speed_mps == pytest.approx(
            max(low, min(high, limits.SPD_LOST))
        ):
            pass  # nobody to hold on to: the limit of the correction alone
        elif self.too_close(track, own) and not self.led_away(guard):
            assert r.speed_mps <= low + SLACK

    def check_held(self) -> None:
        """The point is moved so far and no further: 1 m towards the leader, 5 m away from it."""
        vehicle = self.r.vehicle
        kind, target = vehicle.targets[-1]
        assert kind == "posvel"
        ahead_m, mps, since_ms = self.streamed
        ahead_m += mps * (vehicle.t_ms - since_ms) / 1000.0
        moved_m = float(target[0] or 0.0) - ahead_m
        assert moved_m <= FORWARD_M + HELD_SLACK_M
        if float(target[0] or 0.0) < GENTLE_M - HELD_SLACK_M:
            assert moved_m >= -BACK_M - BRAKING_M - HELD_SLACK_M

    def check_texts(self) -> None:
        """No error of the applet's own, which it would survive and tell."""
        texts = self.r.vehicle.texts
        while self.heard < len(texts):
            assert not texts[self.heard][1].startswith("ECHO: error"), texts[self.heard]
            self.heard += 1

    def too_close(self, track: Any, own: Any) -> bool:
        """By the rangefinder's status, or by readings that agree."""
        status, value = self.r.vehicle.ranges[0]
        low = status == LOW and value >= 0.0 and math.isfinite(value)
        return low or (bool(track.trusted(own.at_ms)) and track.range_m < HARD_CLOSE_M)

    def led_away(self, guard: Any) -> bool:
        """A target away from the leader: the applet's own, or the stream's of late."""
        vehicle = self.r.vehicle
        target = vehicle.target
        own = target is not None and target[0] < 39.34
        return bool(guard.evading) or own or vehicle.t_ms - self.behind_ms <= 1000


@pytest.mark.parametrize("flights", [200, pytest.param(1000, marks=pytest.mark.long)])
def test_what_must_always_hold(rig: MakeRig, flights: int) -> None:
    @settings(
        max_examples=flights,
        deadline=None,
        derandomize=True,  # the same flights everywhere
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(sequence=st.lists(actions, min_size=5, max_size=20))
    def fly(sequence: list[tuple[Any, ...]]) -> None:
        r = rig(SWITCH=300)
        r.vehicle.switches[300] = 2
        watch = Watch(r)
        watch.wait(8)
        for action in sequence:
            watch.do(action)

    fly()
