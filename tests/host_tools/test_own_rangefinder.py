"""The simulated autopilot's own drivers of rangefinders, and what reads a sensor by them."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.setup.checks import Verdict, examine
from echowing.setup.settings import settings_for
from echowing.sim.aircraft import SensorDriver
from echowing.sim.vehicle.rangefinder import (
    GOOD,
    MAXBOTIX_TYPE,
    NO_DATA,
    NOT_CONNECTED,
    OUT_OF_RANGE_HIGH,
    OUT_OF_RANGE_LOW,
)
from echowing.sim.world.sonar import MaxSonar
from echowing.sonar_file import MAVLINK_TYPE, load_sonar

from .autopilot_bench import Bench
from .test_setup import ready

TFMINI_TYPE = 25


class Nose:
    """A vehicle with a sensor that its autopilot reads; set_to: RNGFND1_TYPE, if not its."""

    def __init__(self, kind: int = MAXBOTIX_TYPE, set_to: int | None = None) -> None:
        of_sensor = kind if set_to is None else set_to
        self.bench = Bench(parameters={"RNGFND1_TYPE": float(of_sensor), "RNGFND1_ORIENT": 0.0})
        self.range_m: float | None = 3.0
        self.sensor = MaxSonar(lambda t_s: self.range_m)
        self.driver = SensorDriver(self.sensor, self.bench.autopilot, kind, rate_hz=10.0)

    def fly(self, seconds: float) -> "Nose":
        for _ in range(round(seconds * 50)):
            self.driver.step(round(self.bench.t_s * 1e6))
            self.bench.step()
        return self

    @property
    def status(self) -> tuple[int, float]:
        autopilot = self.bench.autopilot
        return autopilot.rangefinder_status(0), round(autopilot.rangefinder_distance_m(0), 2)

    @property
    def read_ms(self) -> int:
        return self.bench.autopilot.rangefinder.read_ms


@pytest.mark.parametrize("kind", [MAXBOTIX_TYPE, TFMINI_TYPE])
def test_it_is_read(kind: int) -> None:
    nose = Nose(kind).fly(0.5)
    assert nose.status == (GOOD, 3.0)
    sensors = [nose.bench.autopilot.rangefinder_backend(number) for number in range(2)]
    assert sensors == [(0, kind, GOOD, 3.0, nose.read_ms), None]


@pytest.mark.parametrize("set_to", [TFMINI_TYPE, MAVLINK_TYPE])
def test_set_to_another_type_it_is_not_read(set_to: int) -> None:
    assert Nose(set_to=set_to).fly(0.5).status[0] in (NOT_CONNECTED, NO_DATA)


def test_what_comes_by_mavlink_is_not_its() -> None:
    nose = Nose().fly(0.5)
    for _ in range(5):
        nose.bench.sonar(150)
        nose.bench.step()
        assert nose.status == (GOOD, 3.0)


def test_a_maxbotix_is_read_a_period_after_its_ping_and_handed_out_later_than_it_is_stamped() -> (
    None
):
    nose = Nose().fly(1.0)
    stamp_ms = nose.read_ms
    nose.range_m = 2.0
    nose.fly(0.1)  # pinged
    assert nose.read_ms > stamp_ms
    assert nose.status == (GOOD, 3.0)
    stamp_ms = nose.read_ms
    while nose.read_ms == stamp_ms:
        nose.fly(0.02)
    # The stamp is of now, the distance still the one before, or of this update.
    nose.fly(0.06)
    assert nose.status == (GOOD, 2.0)


@pytest.mark.parametrize("kind", [MAXBOTIX_TYPE, TFMINI_TYPE])
def test_a_sensor_that_falls_silent_has_no_data(kind: int) -> None:
    nose = Nose(kind).fly(0.5)
    nose.sensor.plugged = False
    stamp_ms = nose.fly(0.2).read_ms
    nose.fly(0.5)
    assert nose.status[0] == NO_DATA
    assert nose.read_ms == stamp_ms


def test_beyond_its_span_it_says_so() -> None:
    nose = Nose(TFMINI_TYPE)
    nose.range_m = None
    assert nose.fly(0.5).status[0] == OUT_OF_RANGE_HIGH
    nose.range_m = 0.1
    assert nose.fly(0.5).status[0] == OUT_OF_RANGE_LOW


def test_it_is_sent_as_the_autopilots_own() -> None:
    nose = Nose().fly(0.5)
    assert nose.bench.command(
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, 100_000
    ) == (mavlink.MAV_RESULT_ACCEPTED)
    nose.bench.heard("DISTANCE_SENSOR").clear()
    nose.fly(2.0)
    heard = nose.bench.heard("DISTANCE_SENSOR")
    assert 18 <= len(heard) <= 22
    assert {(one.current_distance, one.orientation, one.get_srcComponent()) for one in heard} == {
        (300, 0, 1)
    }


# ---- setup ------------------------------------------------------------------------------------


def of_its_own(**changes: Any) -> dict[str, tuple[Verdict, str]]:
    """What is not fine of a vehicle that needs no co-processor, and has none."""
    none: dict[str, Any] = {
        "serial_port": None,
        "coprocessor": None,
        "coprocessor_status": None,
        "coprocessor_parameters": {},
        "reports": None,
        "range_type": MAXBOTIX_TYPE,
        "RNGFND1_TYPE": float(MAXBOTIX_TYPE),
    }
    readout = ready(**(none | changes))
    return {
        one.about: (one.verdict, one.fix)
        for one in examine(readout)
        if one.verdict in (Verdict.WRONG, Verdict.UNKNOWN)
    }


def test_no_co_processor_is_asked_for() -> None:
    assert of_its_own() == {}
    assert "co-processor" in of_its_own(range_type=MAVLINK_TYPE)


def test_another_type_is_wrong_and_one_of_the_co_processors_is_replaced() -> None:
    wrong = of_its_own(RNGFND1_TYPE=10.0)
    assert wrong["RNGFND1_TYPE"][1].startswith("param set RNGFND1_TYPE 2")
    assert "RNGFND1_TYPE" in of_its_own(RNGFND1_TYPE=25.0)


def test_a_driver_without_data_is_told() -> None:
    verdict, fix = of_its_own(takes_range=False)["range in the autopilot"]
    assert verdict is Verdict.WRONG
    assert "wires" in fix


def test_nothing_of_the_co_processor_is_written() -> None:
    names = {one.name for one in settings_for(ready(range_type=MAXBOTIX_TYPE))}
    assert not [name for name in names if name.startswith(("SERIAL", "RNGFND1_M", "RNGFND1_ADDR"))]


# ---- sonar files ------------------------------------------------------------------------------


def test_a_sonar_file_says_who_reads_it() -> None:
    assert load_sonar("mb1202-fixed").belief().fixed
    assert not load_sonar("mb1202").belief().fixed
