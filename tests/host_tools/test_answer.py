"""What a log says of how a vehicle answers a speed step."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from echowing.analysis.answer import read_answers
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.mavlink.vehicle_limits import usual_parameters
from echowing.sim.vehicle.dataflash import DataflashLog
from echowing.sim.vehicle.parameters import Generation

from .autopilot_bench import VELOCITY_ONLY, Bench

RECOMMENDED = {"WP_ACC": 5.0, "PSC_JERK_NE": 20.0}


def flown(
    path: Path,
    parameters: Mapping[str, float],
    orders: tuple[float, ...] = (2.0, -2.0, 2.0),
    generation: Generation = Generation.V4_8,
    told: Mapping[str, float] | None = None,
) -> Path:
    """A log of velocities that are held for 5 s each; told: parameters that the log claims."""
    bench = Bench(parameters={**parameters, "WP_SPD": 10.0}, generation=generation)
    for name, value in (told or {}).items():
        bench.autopilot.parameters.set(name, value)
    bench.autopilot.start_log(path)
    for name in told or {}:
        bench.autopilot.parameters.set(name, parameters[name])
    for north_mps in orders:
        for _ in range(10):
            bench.target(0.0, mask=VELOCITY_ONLY, velocity=(north_mps, 0.0, 0.0))
            bench.run(0.5)
    assert bench.autopilot.dataflash is not None
    bench.autopilot.dataflash.close()
    return path


@pytest.mark.parametrize(
    ("parameters", "dead_s"),
    [
        (RECOMMENDED, 0.51),
        ({"WP_ACC": 2.5, "PSC_JERK_NE": 5.0}, 0.6),
        ({**RECOMMENDED, "ATC_ACC_R_MAX": 300.0, "ATC_ACC_P_MAX": 300.0}, 0.66),
        ({**RECOMMENDED, "ATC_INPUT_TC": 0.2}, 0.61),
        ({**RECOMMENDED, "ATC_RATE_R_MAX": 30.0, "ATC_RATE_P_MAX": 30.0}, 0.84),
    ],
)
def test_a_simulated_vehicle_answers_no_later_than_the_envelope_counts_with(
    parameters: dict[str, float], dead_s: float, tmp_path: Path
) -> None:
    answers = read_answers(flown(tmp_path / "a.BIN", parameters))
    assert [one.size_mps for one in answers] == [4.0, 4.0]
    for one in answers:
        assert one.missing == ()
        assert one.counted.decel_mps2 == parameters["WP_ACC"]
        assert one.counted.dead_s == pytest.approx(dead_s, abs=0.01)
        assert one.counted.half_s == pytest.approx(dead_s + 2.0 / parameters["WP_ACC"], abs=0.01)
        # Nor so early that the envelope would give away room.
        assert -0.3 < one.measured.half_s - one.counted.half_s < 0.05
        assert not one.slower


def written(path: Path, *, reaction_s: float, decel_mps2: float, jerk_mps3: float) -> Path:
    """A log of one reversal at 2 m/s that is answered exactly so, 10 velocities a second."""
    log = DataflashLog(path.open("wb"))
    for name, value in (usual_parameters() | RECOMMENDED).items():
        log.write("PARM", 0.0, name, value, value)
    for tick in range(80):
        time_s = 0.1 * tick
        order_mps = 2.0 if time_s < 4.0 else -2.0
        log.write("GUIP", time_s, 4, *(0.0,) * 3, 0, order_mps, *(0.0,) * 5)
        since_s = max(0.0, time_s - 4.0 - reaction_s)
        rising_s = min(since_s, decel_mps2 / jerk_mps3)
        lost_mps = 0.5 * jerk_mps3 * rising_s**2 + decel_mps2 * (since_s - rising_s)
        flown_mps = max(-2.0, 2.0 - lost_mps)
        log.write("XKF1", time_s, 0, *(0.0,) * 3, flown_mps, *(0.0,) * 10)
    log.close()
    return path


@pytest.mark.parametrize(
    ("reaction_s", "decel_mps2", "jerk_mps3", "slower"),
    [(0.3, 5.0, 15.0, False), (0.4, 4.0, 8.0, True), (0.9, 5.0, 15.0, True), (0.3, 2.0, 5.0, True)],
)
def test_a_known_answer_is_measured_and_a_worse_one_is_told(
    reaction_s: float,
    decel_mps2: float,
    jerk_mps3: float,
    slower: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = written(
        tmp_path / "a.BIN", reaction_s=reaction_s, decel_mps2=decel_mps2, jerk_mps3=jerk_mps3
    )
    (one,) = read_answers(path)
    dead_s = reaction_s + decel_mps2 / (2.0 * jerk_mps3) + 0.06
    assert one.measured.decel_mps2 == pytest.approx(decel_mps2, rel=0.06)
    assert one.measured.jerk_mps3 == pytest.approx(jerk_mps3, rel=0.25)
    assert one.measured.dead_s == pytest.approx(dead_s, abs=0.03)
    assert one.measured.half_s == pytest.approx(dead_s + 2.0 / decel_mps2, abs=0.02)
    assert one.slower is slower

    assert main(["analyze", "--answer", str(path)]) == int(slower)
    said = capsys.readouterr().out
    assert "(0.51) s" in said
    assert ("SLOWER" in said) is slower
    assert ("It answers later than its parameters say" in said) is slower
    main(["analyze", "--answer", "--json", str(path)])
    (step,) = json.loads(capsys.readouterr().out)["steps"]
    assert step["slower"] is slower
    assert step["counted"]["decel_mps2"] == 5.0


def test_one_that_flies_other_limits_than_its_log_names_is_told(tmp_path: Path) -> None:
    soft = {**RECOMMENDED, "PSC_JERK_NE": 4.0}
    answers = read_answers(flown(tmp_path / "a.BIN", soft, told=RECOMMENDED))
    assert [one.counted.jerk_mps3 for one in answers] == pytest.approx([15.34, 15.34], abs=0.01)
    assert all(one.slower for one in answers)


def test_parameters_that_the_log_lacks_count_as_the_worst_and_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "a.BIN", reaction_s=0.3, decel_mps2=5.0, jerk_mps3=15.0)
    path.write_bytes(path.read_bytes().replace(b"ATC_INPUT_TC", b"ATC_INPUT_XY"))
    (one,) = read_answers(path)
    assert one.missing == ("ATC_INPUT_TC",)
    assert one.counted.dead_s > 2.0
    main(["analyze", "--answer", str(path)])
    assert "taken as the worst: ATC_INPUT_TC" in capsys.readouterr().out


def test_centimetres_of_older_logs_are_read_as_such(tmp_path: Path) -> None:
    """ArduCopter up to 4.6 says so in FMTU: 2 cm/s here are no step."""
    path = written(tmp_path / "a.BIN", reaction_s=0.3, decel_mps2=5.0, jerk_mps3=15.0)
    path.write_bytes(path.read_bytes().replace(b"F-000-000000", b"F-BBB-BBBBBB"))
    with pytest.raises(EchowingError, match="no speed step"):
        read_answers(path)


@pytest.mark.parametrize(
    "orders",
    [(2.0, 1.0, 0.0, -1.0), (2.0,), ()],  # steps too small, none, nothing at all
)
def test_a_log_without_a_step_is_one_clear_line(
    orders: tuple[float, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = flown(tmp_path / "a.BIN", RECOMMENDED, orders)
    assert main(["analyze", "--answer", str(path)]) == 2
    said = capsys.readouterr().err
    assert "no speed step of 2 m/s or more in Guided" in said
    assert "Traceback" not in said


def test_what_is_no_vehicles_own_log_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "a.tlog"
    other.write_bytes(b"no log")
    with pytest.raises(EchowingError, match="needs the vehicle's own log"):
        read_answers(other)
    with pytest.raises(EchowingError, match="cannot be read"):
        read_answers(tmp_path / "gone.BIN")
