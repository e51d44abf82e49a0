"""Flights from real logs: excerpts of a recording (data/README.md) and logs written here."""

import json
import math
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.logs import compare_with_truth, read_flights
from echowing.analysis.metrics import by_sonar, metrics
from echowing.analysis.vehicle_log import DATAFLASH_TYPES, TLOG_TYPES, gps_to_unix_s, read_vehicles
from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.guidance import Slot

DATA = Path(__file__).parent / "data"
COMBINATIONS = [(a, b) for a in ("tlog", "BIN") for b in ("tlog", "BIN")]
START_UNIX_S = 1_800_000_000.0
ORIGIN_LAT, METRE_LAT = 39.0, 1.0 / 110_998.0  # degrees a metre north there (WGS-84, 250 m up)


# --- the recording -------------------------------------------------------------------------


@pytest.mark.parametrize(("leader", "follower"), COMBINATIONS)
def test_every_mix_of_logs_gives_the_same_separation(leader: str, follower: str) -> None:
    """1 cm apart at most: one clock, or 2 m/s would turn 0.1 s into 20 cm."""
    (mixed,) = read_flights([DATA / f"follower.{follower}", DATA / f"leader.{leader}"])
    (alike,) = read_flights([DATA / "leader.BIN", DATA / "follower.BIN"])
    assert mixed.start_unix_s is not None and alike.start_unix_s is not None
    there = alike.time_s + alike.start_unix_s - mixed.start_unix_s
    inside = (there > 0.0) & (there < mixed.time_s[-1])
    separation_m = np.interp(there[inside], mixed.time_s, mixed.separation_m)
    difference_m = separation_m - alike.separation_m[inside]
    assert abs(difference_m.mean()) < 0.01
    assert np.abs(difference_m).max() < 0.1
    assert mixed.warnings == ()


@pytest.mark.parametrize(("leader", "follower"), COMBINATIONS)
def test_the_logs_differ_from_the_truth_by_the_drift_of_the_receivers(
    leader: str, follower: str
) -> None:
    """In these 20 s the receivers disagree by some decimetres; 1 m would be a wrong alignment."""
    (flight,) = read_flights([DATA / f"leader.{leader}", DATA / f"follower.{follower}"])
    compared = compare_with_truth(flight, DATA / "truth.csv")
    assert compared.samples > 180
    assert compared.truth_mean_m == pytest.approx(3.41, abs=0.05)
    assert 0.15 < compared.bias_m < 0.35
    assert 0.3 < compared.rms_m < 0.5
    assert compared.bias_m == pytest.approx(compared.log_mean_m - compared.truth_mean_m)


def test_the_truths_clock_can_be_matched_by_the_speeds() -> None:
    (flight,) = read_flights([DATA / "leader.BIN", DATA / "follower.BIN"])
    compared = compare_with_truth(flight, DATA / "truth.csv", match_clocks=True)
    assert compared.clock_shift_s == pytest.approx(-0.72, abs=0.1)  # data/README.md
    assert compared.rms_m < compare_with_truth(flight, DATA / "truth.csv").rms_m


def analyzed(folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    logs = [str(folder / f"{who}.BIN") for who in ("leader", "follower")]
    assert main(["analyze", *logs, "--settle", "0", "--json"]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


def test_a_truth_beside_the_logs_leads_where_it_is_of_this_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = analyzed(DATA, capsys)
    assert told["source"] == "in truth"
    assert told["mean_separation_m"] == pytest.approx(3.43, abs=0.05)
    for who in ("leader", "follower"):
        shutil.copy(DATA / f"{who}.BIN", tmp_path)
    without = analyzed(tmp_path, capsys)
    assert (without["source"], without["warnings"]) == ("by sonar", [])
    columns = "unix_time_s,separation_m,follower_speed_mps\n"
    (tmp_path / "truth.csv").write_text(f"{columns}1,2,3\n", encoding="utf-8")
    another = analyzed(tmp_path, capsys)
    assert another["source"] == "by sonar"
    (warning,) = another["warnings"]
    assert "truth.csv is not used" in warning
    assert "no time in common" in warning


@pytest.mark.parametrize("kind", ["tlog", "BIN"])
def test_sonar_and_speed_command_come_with_the_follower(kind: str) -> None:
    (flight,) = read_flights([DATA / f"leader.{kind}", DATA / f"follower.{kind}"])
    ours = metrics(flight)
    assert ours.seen_share == pytest.approx(0.87, abs=0.02)
    assert 2.0 < np.nanmin(flight.sonar_m) < np.nanmax(flight.sonar_m) < 7.65
    known = np.isfinite(flight.speed_command_mps)
    assert known.mean() > 0.95  # unknown until the first report
    assert set(flight.speed_command_mps[known]) == {3.0, 3.5, 4.0, 4.5}
    assert np.isnan(flight.pan_us).all()  # that rig did not log its gimbal
    speed_mps = np.hypot(*flight.leader_velocity_mps[:, :2].T)
    assert speed_mps.mean() == pytest.approx(2.0, abs=0.3)


def test_the_simulators_own_messages_are_never_read() -> None:
    assert not [name for name in (*TLOG_TYPES, *DATAFLASH_TYPES) if "SIM" in name]


def test_a_log_holding_both_vehicles_is_enough(tmp_path: Path) -> None:
    both = tmp_path / "both.tlog"
    both.write_bytes((DATA / "leader.tlog").read_bytes() + (DATA / "follower.tlog").read_bytes())
    (flight,) = read_flights([both])
    assert metrics(flight).mean_separation_m == pytest.approx(3.67, abs=0.05)


def test_the_caller_can_say_who_leads() -> None:
    paths = [DATA / "leader.BIN", DATA / "follower.BIN"]
    (usual,) = read_flights(paths)
    (swapped,) = read_flights(paths, leader=DATA / "follower.BIN")
    assert (usual.name, swapped.name) == ("leader.BIN + follower.BIN", "follower.BIN + leader.BIN")
    assert swapped.separation_m.mean() == pytest.approx(usual.separation_m.mean(), abs=0.05)
    assert usual.sonar_known
    assert not swapped.sonar_known
    with pytest.raises(EchowingError, match="leader 7"):
        read_flights(paths, leader=7)


# --- what is wrong with logs ------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["tlog", "BIN"])
def test_half_a_log_gives_half_a_flight(tmp_path: Path, kind: str) -> None:
    data = (DATA / f"follower.{kind}").read_bytes()
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(data[: len(data) // 2 + 3])
    (flight,) = read_flights([DATA / "leader.BIN", cut])
    assert 5.0 < flight.time_s[-1] < 12.0
    assert metrics(flight).left_out == 0


@pytest.mark.parametrize("kind", ["tlog", "BIN"])
@pytest.mark.parametrize("bytes_gone", [1, 3, 40])
def test_a_log_that_was_cut_off_says_so(tmp_path: Path, kind: str, bytes_gone: int) -> None:
    whole = read_flights([DATA / "leader.BIN", DATA / f"follower.{kind}"])[0].warnings
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes((DATA / f"follower.{kind}").read_bytes()[:-bytes_gone])
    (flight,) = read_flights([DATA / "leader.BIN", cut])
    note = f"{cut}: damaged or cut off; the readable part is used"
    assert note in flight.warnings
    assert not any("cut off" in text for text in whole)


def test_a_log_without_a_whole_message_says_so(tmp_path: Path) -> None:
    stub = tmp_path / "stub.tlog"
    stub.write_bytes((DATA / "leader.tlog").read_bytes()[:25])
    with pytest.raises(EchowingError, match=r"no whole message in its 25 bytes"):
        read_flights([stub, DATA / "follower.BIN"])


@pytest.mark.parametrize("kind", ["tlog", "BIN"])
def test_damage_in_the_middle_is_skipped_with_a_warning(
    tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    data = (DATA / f"follower.{kind}").read_bytes()
    hurt = tmp_path / f"hurt.{kind}"
    hurt.write_bytes(data[:12_000] + bytes(range(256)) + data[12_100:])
    (flight,) = read_flights([DATA / "leader.BIN", hurt])
    assert flight.time_s[-1] > 18.0
    assert any("hurt" in text and "damaged" in text for text in flight.warnings)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "is empty"),
        (b"these are my notes of the flight\n" * 20, "no MAVLink messages"),
        (b"\xa3\x95\x80\x80", "no POS message"),
        (bytes(i * 37 % 251 for i in range(5000)), "no MAVLink messages"),
    ],
)
def test_what_is_no_log_is_named(tmp_path: Path, data: bytes, complaint: str) -> None:
    path = tmp_path / "odd.log"
    path.write_bytes(data)
    with pytest.raises(EchowingError, match=f"odd.log.*{complaint}"):
        read_flights([path, DATA / "follower.BIN"])


def test_a_missing_log_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match=r"gone\.BIN.*No such file"):
        read_flights([tmp_path / "gone.BIN", DATA / "follower.BIN"])


def test_one_log_is_not_enough() -> None:
    with pytest.raises(EchowingError, match="the log of each"):
        read_flights([DATA / "leader.BIN"])


@pytest.mark.parametrize("other", ["leader.BIN", "leader.tlog"])
def test_the_same_vehicle_twice_is_refused(other: str) -> None:
    with pytest.raises(EchowingError, match="two vehicles"):
        read_flights([DATA / "leader.BIN", DATA / other])


def test_a_copy_stated_as_leader_is_found_by_its_track(tmp_path: Path) -> None:
    copy = tmp_path / "copy.tlog"
    shutil.copy(DATA / "leader.tlog", copy)
    with pytest.raises(EchowingError, match="the same track"):
        read_flights([copy, DATA / "leader.BIN"], leader=copy)


# --- logs written here ------------------------------------------------------------------------


class Tlog:
    """Writes a vehicle's telemetry as a ground station would: 5 Hz, flying north at 2 m/s."""

    def __init__(self, system_id: int, *, clock: bool = True, mode: int = 4, kind: int = 2) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self.data = b""
        self.clock, self.mode, self.kind = clock, mode, kind

    def put(self, unix_s: float, message: Any) -> None:
        self.data += struct.pack(">Q", round(unix_s * 1e6)) + message.pack(self.mav)

    def fly(
        self,
        north_m: Callable[[float], float],
        *,
        seconds: float = 10.0,
        boot_s: float = 100.0,
        start_unix_s: float = START_UNIX_S,
        delay_s: float = 0.3,
        sonar_cm: int | None = None,
    ) -> "Tlog":
        """`boot_s`: the vehicle's own clock at the start; `delay_s`: of the radio."""
        for step in range(int(seconds * 5)):
            t_s = step / 5.0
            heard_s = start_unix_s + t_s + delay_s
            boot_ms = round((boot_s + t_s) * 1000)
            if step % 5 == 0:
                self._once_a_second(heard_s, start_unix_s + t_s, boot_ms)
            lat = round((ORIGIN_LAT + north_m(t_s) * METRE_LAT) * 1e7)
            fix = (boot_ms, lat, -860_000_000, 260_000, 10_000, 200, 0, 0, 0)
            self.put(heard_s, mavlink.MAVLink_global_position_int_message(*fix))
            if sonar_cm is not None:
                reading = (boot_ms, 20, 765, sonar_cm, 1, 1, 0, 255)
                self.put(heard_s, mavlink.MAVLink_distance_sensor_message(*reading))
        return self

    def sync(self, *, boot_s: float, delay_s: float) -> "Tlog":
        """A question of the ground station and the vehicle's answer, `delay_s` each way."""
        asked_ns = 4_200_000_000
        ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        own, self.mav = self.mav, ground
        self.put(START_UNIX_S, mavlink.MAVLink_timesync_message(0, asked_ns))
        self.mav = own
        vehicle_ns = round((boot_s + delay_s) * 1e9)
        answer = mavlink.MAVLink_timesync_message(vehicle_ns, asked_ns)
        self.put(START_UNIX_S + 2.0 * delay_s, answer)
        return self

    def _once_a_second(self, heard_s: float, unix_s: float, boot_ms: int) -> None:
        heartbeat = (self.kind, 3, 209, self.mode, 4, 3)
        self.put(heard_s, mavlink.MAVLink_heartbeat_message(*heartbeat))
        if self.clock:
            stamp_us = round(unix_s * 1e6)
            self.put(heard_s, mavlink.MAVLink_system_time_message(stamp_us, boot_ms))

    def save(self, path: Path) -> Path:
        path.write_bytes(self.data)
        return path


def north(t_s: float) -> float:
    return 2.0 * t_s


def behind(t_s: float) -> float:
    return 2.0 * t_s - 3.5


def pair(folder: Path, leader: Tlog, follower: Tlog) -> list[Path]:
    return [leader.save(folder / "a.tlog"), follower.save(folder / "b.tlog")]


def test_boot_clocks_and_radio_delays_do_not_shift_the_vehicles(tmp_path: Path) -> None:
    """Booted 9 minutes apart, one radio 0.7 s slower: 2 m/s x 0.7 s would be 1.4 m."""
    leader = Tlog(1, mode=3).fly(north, boot_s=40.0, delay_s=0.2)
    follower = Tlog(2).fly(behind, boot_s=580.0, delay_s=0.9, sonar_cm=350)
    (flight,) = read_flights(pair(tmp_path, leader, follower))
    assert flight.separation_m == pytest.approx(3.5, abs=0.03)
    assert flight.sonar_m[20] == pytest.approx(3.5)
    assert flight.warnings == ()
    # 3.5 m behind its leader on a slot of 3 m: half a metre short, on course
    assert metrics(flight).forward_mean_m == pytest.approx(-0.5, abs=0.03)


def test_without_gps_time_reception_aligns_them_with_a_warning(tmp_path: Path) -> None:
    leader = Tlog(1, mode=3).fly(north, delay_s=0.3)
    follower = Tlog(2, clock=False).fly(behind, boot_s=7.0, delay_s=0.3, sonar_cm=350)
    (flight,) = read_flights(pair(tmp_path, leader, follower))
    assert flight.separation_m == pytest.approx(3.5, abs=0.03)
    assert any("no GPS time" in text and "b.tlog" in text for text in flight.warnings)


def test_timesync_aligns_them_before_reception_does(tmp_path: Path) -> None:
    """No GPS time, and one radio takes 0.8 s each way: 1.6 m if reception were believed."""
    leader = Tlog(1, clock=False, mode=3).sync(boot_s=40.0, delay_s=0.8)
    leader.fly(north, boot_s=40.0, delay_s=0.8)
    follower = Tlog(2, clock=False).sync(boot_s=9.0, delay_s=0.1)
    follower.fly(behind, boot_s=9.0, delay_s=0.1, sonar_cm=350)
    (flight,) = read_flights(pair(tmp_path, leader, follower))
    assert flight.separation_m == pytest.approx(3.5, abs=0.03)
    assert any("TIMESYNC" in text for text in flight.warnings)


def test_the_sonars_own_word_for_nothing_is_no_reading(tmp_path: Path) -> None:
    follower = Tlog(2).fly(behind, sonar_cm=350)
    for step in range(100):
        value_m = 3.4 if step < 50 else 7.66
        value = mavlink.MAVLink_named_value_float_message(0, b"SNR_RAW", value_m)
        follower.put(START_UNIX_S + step / 10.0 + 0.3, value)
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    assert metrics(flight).seen_share == pytest.approx(0.5, abs=0.03)
    assert np.nanmax(flight.sonar_m) == pytest.approx(3.4)


@pytest.mark.parametrize("inset_m", [None, 0.45])
def test_the_sonars_inset_is_as_its_applet_was_told(tmp_path: Path, inset_m: float | None) -> None:
    follower = Tlog(2).fly(behind, sonar_cm=350)
    if inset_m is not None:
        told = mavlink.MAVLink_param_value_message(b"ECHO_INSET", inset_m, 9, 1, 0)
        follower.put(START_UNIX_S + 1.0, told)
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    ours = by_sonar(flight)
    assert ours is not None
    assert ours.mean_separation_m == pytest.approx(3.5 + (inset_m or 0.2))


def test_a_reading_out_of_limits_is_no_target(tmp_path: Path) -> None:
    follower = Tlog(2).fly(behind, sonar_cm=800)
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    assert flight.sonar_known
    assert metrics(flight).seen_share == 0.0


def test_an_old_reading_is_no_reading(tmp_path: Path) -> None:
    follower = Tlog(2).fly(behind, seconds=5.0, sonar_cm=350)
    follower.fly(
        lambda t_s: behind(t_s + 5.0),
        seconds=5.0,
        boot_s=105.0,
        start_unix_s=START_UNIX_S + 5.0,
    )
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    last_s = flight.time_s[np.isfinite(flight.sonar_m)].max()
    assert last_s == pytest.approx(4.8 + 0.5, abs=0.15)  # the last reading, and 0.5 s


def test_the_clock_of_another_component_is_not_the_vehicles(tmp_path: Path) -> None:
    """A co-processor shares the system id, and has its own idea of time and place."""
    follower = Tlog(2).fly(behind, sonar_cm=350)
    other = Tlog(2, kind=18)
    other.mav = mavlink.MAVLink(None, srcSystem=2, srcComponent=158)
    other.fly(lambda t_s: 900.0, boot_s=3.0, start_unix_s=START_UNIX_S + 60.0)
    follower.data = other.data + follower.data
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    assert flight.separation_m == pytest.approx(3.5, abs=0.03)


def test_the_one_not_in_guided_leads_where_nobody_has_a_sonar(tmp_path: Path) -> None:
    paths = pair(tmp_path, Tlog(1).fly(behind), Tlog(2, mode=3).fly(north))
    (flight,) = read_flights(paths)
    assert flight.name == "b.tlog + a.tlog"  # the leader first
    assert not flight.sonar_known


def test_two_alike_need_a_word_from_the_caller(tmp_path: Path) -> None:
    paths = pair(tmp_path, Tlog(1).fly(north), Tlog(2).fly(behind))
    with pytest.raises(EchowingError, match=r"the logs do not show which of .* led"):
        read_flights(paths)
    (flight,) = read_flights(paths, leader=1)
    assert flight.separation_m == pytest.approx(3.5, abs=0.03)


def test_logs_of_two_days_do_not_overlap(tmp_path: Path) -> None:
    late = Tlog(2).fly(behind, start_unix_s=START_UNIX_S + 86_400, sonar_cm=350)
    with pytest.raises(EchowingError, match=r"do not overlap.*2027-01-15 .*2027-01-16 "):
        read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), late))


def test_a_plane_is_refused(tmp_path: Path) -> None:
    plane = Tlog(1, mode=3, kind=1).fly(north)
    with pytest.raises(EchowingError, match=r"a\.tlog: system 1 is not a copter"):
        read_flights(pair(tmp_path, plane, Tlog(2).fly(behind, sonar_cm=350)))


def test_what_came_before_a_reboot_is_left_out(tmp_path: Path) -> None:
    follower = Tlog(2).fly(behind, boot_s=500.0, sonar_cm=350)
    follower.fly(behind, boot_s=5.0, start_unix_s=START_UNIX_S + 20.0, sonar_cm=350)
    leader = Tlog(1, mode=3).fly(lambda t_s: 2.0 * (t_s % 20.0), seconds=30.0)
    (flight,) = read_flights(pair(tmp_path, leader, follower))
    assert flight.start_unix_s == pytest.approx(START_UNIX_S + 20.0, abs=0.3)
    assert flight.separation_m == pytest.approx(3.5, abs=0.03)
    assert any("rebooted" in text for text in flight.warnings)


def test_a_pause_in_the_log_is_a_gap_not_a_line(tmp_path: Path) -> None:
    follower = Tlog(2).fly(behind, seconds=4.0, sonar_cm=350)
    follower.fly(
        lambda t_s: behind(t_s + 7.0),
        seconds=3.0,
        boot_s=107.0,
        start_unix_s=START_UNIX_S + 7.0,
        sonar_cm=350,
    )
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    blind = np.isnan(flight.separation_m)
    assert blind.sum() == pytest.approx(32, abs=2)  # 3.8 s to 7.0 s at 10 Hz
    assert metrics(flight).left_out == blind.sum()


def test_time_out_of_guided_is_left_out_and_said(tmp_path: Path) -> None:
    follower = Tlog(2, mode=5).fly(behind, seconds=5.0, sonar_cm=350)
    follower.mode = 4
    follower.fly(
        lambda t_s: behind(t_s + 5.0),
        seconds=5.0,
        boot_s=105.0,
        start_unix_s=START_UNIX_S + 5.0,
        sonar_cm=350,
    )
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower))
    assert flight.time_s[-1] == pytest.approx(4.8, abs=0.2)
    assert any("not in Guided" in text for text in flight.warnings)


def test_the_wanted_slot_is_the_callers(tmp_path: Path) -> None:
    follower = Tlog(2).fly(behind, sonar_cm=350)
    slot = Slot(3.5, math.radians(90.0))  # on the leader's right
    (flight,) = read_flights(pair(tmp_path, Tlog(1, mode=3).fly(north), follower), slot=slot)
    ours = metrics(flight)
    assert ours.rmsd_m == pytest.approx(0.0, abs=0.03)  # the distance is right
    assert ours.forward_mean_m == pytest.approx(-3.5, abs=0.03)  # the place is not
    assert ours.right_mean_m == pytest.approx(-3.5, abs=0.03)


@pytest.mark.parametrize(
    ("week", "milliseconds", "unix_s"),
    [
        (2445, 523_621_400.0, 1_795_224_403.4),  # 18 s, as the recording's own clock says
        (1930, 0.0, 1_483_228_783.0),  # 17 s until 2016 had ended, by UTC
        (1930, 18_000.0, 1_483_228_800.0),  # 18 s from 2017-01-01 00:00:00 UTC on
    ],
)
def test_gps_time_loses_its_leap_seconds(week: int, milliseconds: float, unix_s: float) -> None:
    assert gps_to_unix_s(week, milliseconds) == pytest.approx(unix_s, abs=0.001)


def test_a_dataflash_log_tells_its_system() -> None:
    (vehicle,) = read_vehicles(DATA / "follower.BIN")
    assert (vehicle.system_id, vehicle.kind, vehicle.clock) == (2, "BIN", "gps")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a,b\n1,2\n", "needs the columns"),
        ("unix_time_s,separation_m,follower_speed_mps\n1,x,3\n", "needs the columns"),
        ("unix_time_s,separation_m,follower_speed_mps\n1,2,3\n", "no time in common"),
        ("unix_time_s,separation_m,follower_speed_mps\n", "no time in common"),
    ],
)
def test_a_truth_that_does_not_fit_is_named(tmp_path: Path, text: str, complaint: str) -> None:
    (flight,) = read_flights([DATA / "leader.BIN", DATA / "follower.BIN"])
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(EchowingError, match=complaint):
        compare_with_truth(flight, path)
