"""The board's binary in the whole loop: it looks at its leader from a vehicle that leans and yaws.

Real bytes of ATTITUDE and orders go in, real pulses turn simulated servos, and the sonar hears what
is in their beam. The board is the Mega, or what ECHOWING_BOARD says (`make test-stm32`).
"""

import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink
from tests.firmware.bench import BOARD, OUR_COMPONENT, VEHICLE_ID, Bench, BenchSonar

from echowing.flight.sonar import PAN_CENTRE_US, TILT_CENTRE_US
from echowing.geo import Ned
from echowing.sim.boards import firmware
from echowing.sim.boards.coprocessor import AUTOPILOT_PORT
from echowing.sim.world.sonar import Gimbal, Pose, Target, body_to_ned, target_range_m

pytestmark = pytest.mark.seconds(8)

STEP_S = 0.002
LEARNED_S = 6.0  # by then it knows its vehicle
FLOWN_S = 12.0
SWING_RPS = 1.5  # of the vehicle that leans and yaws
ATTITUDE_S, ORDER_S = 0.04, 0.1
EARTH_FRAME = 4 | 8 | 16 | 64
# The search without orders (Figure 28), and how long a round of it takes at most: 300 ms each, and
# a reading that hears nothing.
FIGURE_8 = (
    *((1330, 1500), (1380, 1500), (1400, 1500), (1400, 1400), (1380, 1400), (1330, 1400)),
    *((1330, 1300), (1380, 1300), (1400, 1300)),
)
FIGURE_8_S = 12 * 0.4
FRAME_US = 25_000.0
# A beam of 40 degrees.
HALF_BEAM_RAD = math.radians(20.0)
LEADER = Target((3.0, 0.0, 0.0))
HERE = (0.0, 0.0, 0.0)


@dataclass
class Turn:
    """How the vehicle is turned, radians, and how fast it turns."""

    roll: float
    pitch: float
    yaw: float
    rates: tuple[float, float, float]


def leaning(t_s: float) -> Turn:
    """Leans as a copter does that brakes and speeds up; its nose swings by 45 degrees each way."""
    roll, pitch, yaw = math.radians(12.0), math.radians(15.0), math.radians(45.0)
    w = SWING_RPS
    return Turn(
        roll * math.sin(2 * w * t_s),
        pitch * math.cos(w * t_s),
        yaw * math.sin(w * t_s),
        (
            2 * w * roll * math.cos(2 * w * t_s),
            -w * pitch * math.sin(w * t_s),
            w * yaw * math.cos(w * t_s),
        ),
    )


@dataclass
class Flight:
    """A board on a vehicle; its sonar hears a leader 3 m north. Orders say so, if there are any."""

    ordered: bool
    deaf: bool = False
    pings: list[tuple[float, Ned, bool]] = field(default_factory=list)  # time, axis, heard

    def __post_init__(self) -> None:
        self._gimbal = Gimbal()
        elf = firmware.elf_path(BOARD.name)
        firmware.check_elf(elf, BOARD.name)
        self.bench = Bench(elf, BenchSonar(self._listen), armed=True)
        self._autopilot = mavlink.MAVLink(None, srcSystem=VEHICLE_ID, srcComponent=1)

    def _listen(self, t_s: float) -> float | None:
        turn = leaning(t_s - LEARNED_S)
        axis = body_to_ned(self._gimbal.axis_body(), turn.roll, turn.pitch, turn.yaw)
        range_m, off_rad = target_range_m(Pose(HERE, axis), LEADER)
        heard = off_rad <= HALF_BEAM_RAD and not self.deaf
        self.pings.append((t_s * 1e6, axis, heard))
        return range_m if heard else None

    def fly(self, seconds: float = FLOWN_S) -> None:
        """Learn the vehicle, then fly."""
        self.bench.run(LEARNED_S)
        self.pings.clear()
        self.go_on(0.0, seconds)

    def go_on(self, begun_s: float, seconds: float) -> None:
        """Fly on, that long after it began."""
        for k in range(round(seconds / STEP_S)):
            t_s = begun_s + k * STEP_S
            if self._asked and k % round(ATTITUDE_S / STEP_S) == 0:
                self._tell_attitude(t_s)
            if self.ordered and k % round(ORDER_S / STEP_S) == 0:
                self._order()
            self.bench.run(STEP_S)
            pan, tilt = (self.bench.board.pin(pin).width_us for pin in self._pins)
            self._gimbal.step(STEP_S, pan or PAN_CENTRE_US, tilt or TILT_CENTRE_US)

    @property
    def _asked(self) -> bool:
        """The board has asked its autopilot for attitude, 25 times a second."""
        return any(
            (m.message.target_system, m.message.target_component) == (VEHICLE_ID, 1)
            and (m.message.command, m.message.param1, m.message.param2) == (511, 30, 40_000)
            for m in self.bench.messages("COMMAND_LONG")
        )

    @property
    def _pins(self) -> tuple[Any, Any]:
        return self.bench.board.type.pan, self.bench.board.type.tilt

    def _tell_attitude(self, t_s: float) -> None:
        turn = leaning(t_s)
        message = mavlink.MAVLink_attitude_message(
            round(t_s * 1e3), turn.roll, turn.pitch, turn.yaw, *turn.rates
        )
        self.bench.board.feed(AUTOPILOT_PORT, bytes(message.pack(self._autopilot)))

    def _order(self) -> None:
        north = [1.0, 0.0, 0.0, 0.0]
        message = mavlink.MAVLink_gimbal_device_set_attitude_message(
            VEHICLE_ID, OUR_COMPONENT, EARTH_FRAME, north, math.radians(3.0), 0.0, 0.0
        )
        self.bench.send(message, AUTOPILOT_PORT)

    def heard_share(self) -> float:
        """Of all pings."""
        return sum(heard for *_, heard in self.pings) / len(self.pings)

    def ping_before(self, told_us: float) -> Ned:
        """The axis of the ping whose reading was the newest then."""
        read_us = max(t_us for t_us, _ in self.bench.sonar.readings if t_us < told_us)
        return [axis for t_us, axis, _ in self.pings if t_us < read_us][-1]


@pytest.fixture(scope="module")
def looking() -> Iterator[Flight]:
    """Flown with orders."""
    flight = Flight(ordered=True)
    flight.fly()
    yield flight


def forward(q: tuple[float, float, float, float]) -> Ned:
    """Where a rotation turns straight ahead."""
    w, x, y, z = q
    return w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)


def apart_deg(a: Ned, b: Ned) -> float:
    """Angle between unit vectors."""
    return math.degrees(math.acos(max(-1.0, min(1.0, sum(map(float.__mul__, a, b))))))


def test_it_keeps_hearing_its_leader(looking: Flight) -> None:
    assert looking.heard_share() > 0.97
    began_us = (LEARNED_S + 1.0) * 1e6
    ranges_cm = looking.bench.ranges_cm(since_us=began_us)
    assert len(ranges_cm) > 200
    # Two bodies' sizes less than the 3 m from centre to centre.
    assert all(range_cm == pytest.approx(280, abs=3) for range_cm in ranges_cm)


def test_a_gimbal_fixed_to_the_body_loses_it() -> None:
    flight = Flight(ordered=False)
    flight.fly(math.tau / SWING_RPS)  # each swing is as the one before
    assert flight.heard_share() < 0.7
    assert any(range_cm > 765 for range_cm in flight.bench.ranges_cm(since_us=LEARNED_S * 1e6))


def test_the_axis_told_is_the_one_that_the_sonar_looked_along(looking: Flight) -> None:
    began_us = (LEARNED_S + 1.0) * 1e6
    told = looking.bench.messages("GIMBAL_DEVICE_ATTITUDE_STATUS", since_us=began_us)
    assert len(told) > 100
    assert {heard.message.flags for heard in told} == {EARTH_FRAME}
    errors_deg = [
        apart_deg(forward(heard.message.q), looking.ping_before(heard.t_us)) for heard in told
    ]
    # The play, half a degree on each servo, which the firmware cannot know: 0.7. At 70 degrees a
    # second 0.7 more for the 10 ms by which a pulse waits longer or shorter for its frame than on
    # average, and 0.3 for attitude that waits 4 ms longer beside a reading. Where it accelerates,
    # 0.2. Where the servos were sent, or the attitude of the reading, would be 1 and 3 degrees off.
    assert max(errors_deg) < 2.2
    assert statistics.median(errors_deg) < 1.0


def test_the_board_has_time_and_memory_for_it(looking: Flight) -> None:
    assert looking.bench.board.overruns(AUTOPILOT_PORT) == 0
    assert looking.bench.board.meters().stack_headroom_bytes > 1024
    assert looking.bench.board.meters().restarts == 0


def test_a_second_after_the_last_order_it_searches_as_without_orders() -> None:
    """Attitude goes on; the leader is gone, or it would be held where it is heard."""
    flight = Flight(ordered=True, deaf=True)
    flight.bench.run(LEARNED_S)
    flight.go_on(0.0, 2.0)
    ended_us = flight.bench.t_us
    flight.ordered = False
    flight.go_on(2.0, 1.1 + FIGURE_8_S)
    points = set(FIGURE_8)
    assert not points.issuperset(aims(flight, ended_us, ended_us + 0.8e6))
    # The last order came up to 0.1 s before, and new pulses wait for their frame.
    assert set(aims(flight, ended_us + 1.05e6, flight.bench.t_us)) == points


def aims(flight: Flight, from_us: float, until_us: float) -> list[tuple[int, int]]:
    """The pulses that went out then, in order."""
    return [
        (round(pan_us), round(tilt_us))
        for t_us, pan_us, tilt_us in flight.bench.aims(from_us)
        if t_us < until_us
    ]
