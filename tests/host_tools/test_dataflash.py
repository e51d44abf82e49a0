"""The simulated dataflash log reads as a real one with pymavlink's DFReader."""

import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink import DFReader

from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.sim.vehicle.dataflash import DataflashLog, ScriptMessage

from .autopilot_bench import FORWARD_SONAR, Bench


def read(path: Path) -> tuple[Any, dict[str, list[Any]]]:
    reader = DFReader.DFReader_binary(str(path))
    messages: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        messages.setdefault(message.get_type(), []).append(message)
    return reader, messages


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, dict[str, list[Any]]]:
    """Ten seconds: sonar at 3.21 m, a target north, Loiter at the end, a script's message."""
    path = tmp_path_factory.mktemp("log") / "flight.BIN"
    bench = Bench(parameters={**FORWARD_SONAR, "WP_SPD": 3.0})
    bench.autopilot.start_log(path)
    bench.target(100.0, 20.0, 10.0)

    def each() -> None:
        bench.sonar(321)
        if bench.steps % 10 == 0:
            told = ("Rng,Law,St,Txt", "ffBn", "mn--", "00--", (3.21, 1.5, 2, "abcd"))
            bench.autopilot.log_write(ScriptMessage("ECHO", *told))

    bench.run(10.0, each)
    bench.autopilot.send_text(5, "echo: tracking")
    bench.autopilot.parameter_set("WP_SPD", 2.0)
    bench.autopilot.set_mode("LOITER")
    assert bench.autopilot.dataflash is not None
    bench.autopilot.dataflash.close()
    return read(path)


def test_rates_are_a_copter_s(flown: tuple[Any, dict[str, list[Any]]]) -> None:
    messages = flown[1]
    for kind, rate_hz in {
        "RFND": 20,
        "ATT": 10,
        "XKF1": 10,
        "POS": 10,
        "GPS": 5,
        "ECHO": 5,
    }.items():
        assert len(messages[kind]) == pytest.approx(10 * rate_hz, abs=1), kind


def test_values(flown: tuple[Any, dict[str, list[Any]]]) -> None:
    _, messages = flown
    sonar = messages["RFND"][-1]
    assert (sonar.Stat, sonar.Orient, sonar.Quality) == (4, 0, -1)
    assert sonar.Dist == pytest.approx(3.21)
    place, gps = messages["POS"][-1], messages["GPS"][-1]
    assert place.Lat > ORIGIN.lat_deg + 10.0 / 111_200
    assert place.Alt == pytest.approx(260.0, abs=0.2)
    assert place.RelHomeAlt == pytest.approx(10.0, abs=0.2)
    assert gps.Lat == pytest.approx(place.Lat, abs=1e-5)
    assert gps.Alt == pytest.approx(260.0, abs=0.2)
    assert gps.Spd == pytest.approx(3.0, abs=0.1)
    assert gps.GCrs == pytest.approx(math.degrees(math.atan2(20.0, 100.0)), abs=2.0)
    assert min(m.Pitch for m in messages["ATT"]) < -5.0  # it leaned forward to get going
    assert [m.Message for m in messages["MSG"]][1:] == ["echo: tracking"]
    assert [m.Mode for m in messages["MODE"]] == [4, 5]
    target = messages["GUIP"][0]
    assert (target.Type, round(target.pZ, 2)) == (2, 10.0)
    assert target.pX == pytest.approx(100.0, abs=0.05)


def test_parameters_and_their_changes(flown: tuple[Any, dict[str, list[Any]]]) -> None:
    reader, messages = flown
    speeds = [m.Value for m in messages["PARM"] if m.Name == "WP_SPD"]
    assert speeds == [3.0, 2.0]
    assert next(m.Default for m in messages["PARM"] if m.Name == "WP_SPD") == 10.0
    assert reader.params["RNGFND1_TYPE"] == 10.0


def test_a_script_s_message_describes_itself(flown: tuple[Any, dict[str, list[Any]]]) -> None:
    reader, messages = flown
    echo = messages["ECHO"][-1]
    assert (echo.Rng, echo.St, echo.Txt) == (pytest.approx(3.21), 2, "abcd")
    form = reader.formats[reader.name_to_id["ECHO"]]
    assert form.columns == ["TimeUS", "Rng", "Law", "St", "Txt"]
    assert form.units[1:3] == ["m", "m/s"]


def test_times_are_utc_by_gps(flown: tuple[Any, dict[str, list[Any]]]) -> None:
    """The clock is worked out from week, milliseconds and leap seconds."""
    fixes = flown[1]["GPS"]
    assert fixes[0]._timestamp == pytest.approx(1_767_225_600.02, abs=0.05)
    assert fixes[-1]._timestamp - fixes[0]._timestamp == pytest.approx(9.8, abs=0.05)


def test_a_log_can_be_kept_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "hand.BIN"
    log = DataflashLog(path.open("wb"))
    log.message(1.0, "first")
    log.write("MODE", 2.0, 4, 4, 2)
    log.close()
    messages = read(path)[1]
    assert messages["MSG"][0].TimeUS == 1_000_000
    assert messages["MODE"][0].ModeNum == 4
    assert {m.Name for m in messages["FMT"]} >= {"PARM", "GPS", "RFND", "GUIP", "UNIT", "FMTU"}
