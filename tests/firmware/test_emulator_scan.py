"""The flashed binary, emulated: how the gimbal searches and tracks, and what is reported of it.

Times are simulated. The board is listened to on its autopilot port.
"""

import itertools
import math
from pathlib import Path

import pytest

from echowing.flight.sonar import SERVO_US_PER_DEG
from echowing.sim.world.sonar import SERVO_SLEW_DPS

from .bench import CONSOLE_PORT, IS_STM32, SLOWNESS, Bench, BenchSonar

pytestmark = pytest.mark.seconds(11)

# Thesis Appendix A: pan and tilt pulses, us, in the order of the figure 8.
TWELVE_POINTS = [
    (1330, 1400),
    (1330, 1500),
    (1380, 1500),
    (1400, 1500),
    (1400, 1400),
    (1380, 1400),
    (1330, 1400),
    (1330, 1300),
    (1380, 1300),
    (1400, 1300),
    (1400, 1400),
    (1380, 1400),
]
CENTRE = (1380, 1400)
DWELL_S = 0.3
FRAME_US = 20_000.0  # a new pulse is seen with the servo's next frame
NO_TARGET_CM = 766
UNTIL_TRACKING_S = 1.0
# The STM32's core first waits up to twice 10 ms for its USB, and has a millisecond of work, here so
# many times slower (Black Pill: 22.1 ms at its full pace, 25.0 ms at a quarter of it).
CLOCK_BEGINS_MS = 21 + SLOWNESS if IS_STM32 else 0
# The servos stand straight ahead until the first frame after the first turn.
FIRST_FRAME_US = 2 * FRAME_US


def aim_changes(
    bench: Bench, since_us: float = FIRST_FRAME_US
) -> list[tuple[float, tuple[int, int]]]:
    """When the commanded aim changed and what to; within a microsecond or the test fails."""
    changes: list[tuple[float, tuple[int, int]]] = []
    for t_us, pan_us, tilt_us in bench.aims(since_us):
        aim = round(pan_us), round(tilt_us)
        # Limit of the issue: pulse error under 1 us.
        assert (pan_us, tilt_us) == pytest.approx(aim, abs=1.0)
        if not changes or changes[-1][1] != aim:
            changes.append((t_us, aim))
    return changes


def tracking(elf: Path, range_m: float = 2.0) -> Bench:
    """A board that tracks a target at a fixed distance."""
    bench = Bench(elf, BenchSonar(range_m))
    bench.run(UNTIL_TRACKING_S)
    assert bench.named("SNR_STATE")[-1] == 2
    return bench


@pytest.fixture(scope="module")
def searched(elf: Path) -> Bench:
    """Two rounds and a bit without a target."""
    bench = Bench(elf)
    bench.run(2.2 * 12 * DWELL_S)
    return bench


@pytest.fixture(scope="module")
def reported(elf: Path) -> Bench:
    """Ten seconds of tracking, autopilot armed."""
    bench = Bench(elf, BenchSonar(2.0), armed=True)
    bench.run(11.0)
    return bench


class TestSearch:
    def test_follows_the_figure_8_of_the_thesis(self, searched: Bench) -> None:
        visited = [aim for _, aim in aim_changes(searched)]
        assert visited[:24] == TWELVE_POINTS * 2

    def test_dwells_300_ms_at_each_point(self, searched: Bench) -> None:
        times = [t_us for t_us, _ in aim_changes(searched)]
        dwells = [b - a for a, b in itertools.pairwise(times[1:-1])]
        assert dwells == pytest.approx([DWELL_S * 1e6] * len(dwells), abs=FRAME_US + 500)

    def test_pings_at_each_point_after_the_servo_has_arrived(self, searched: Bench) -> None:
        changes = aim_changes(searched)
        for (t_us, aim), (left_us, to) in itertools.pairwise(changes[1:]):
            before = changes[changes.index((t_us, aim)) - 1][1]
            farthest_us = max(abs(aim[0] - before[0]), abs(aim[1] - before[1]))
            arrived_us = t_us + farthest_us / SERVO_US_PER_DEG / SERVO_SLEW_DPS * 1e6
            pings = [t for t in searched.sonar.triggers_us if arrived_us <= t < left_us - FRAME_US]
            assert pings, f"no ping at {aim} before {to}"

    def test_reports_beyond_the_maximum(self, searched: Bench) -> None:
        assert set(searched.ranges_cm()) == {NO_TARGET_CM}

    def test_signal_quality_says_that_nothing_is_heard(self, searched: Bench) -> None:
        newest = searched.messages("DISTANCE_SENSOR")[-1].message
        assert newest.signal_quality == 1  # MAVLink: 1 is invalid, 0 unknown

    def test_starts_where_the_target_was_last_seen(self, elf: Path) -> None:
        # Seen while the gimbal stood at the lower right, 9 points after the start.
        bench = Bench(elf)
        bench.sonar.range_m = lambda t_s: 2.0 if 2.85 < t_s < 3.5 else None
        bench.run(5.0)
        frozen = [aim for t_us, aim in aim_changes(bench) if t_us < 3.0e6][-1]
        assert frozen == (1400, 1300)
        later = [aim for t_us, aim in aim_changes(bench) if t_us > 3.0e6]
        assert later[:3] == [(1400, 1400), (1380, 1400), (1330, 1400)]


class TestTrack:
    def test_target_freezes_the_gimbal(self, elf: Path) -> None:
        bench = tracking(elf)
        bench.run(3.0)
        assert [aim for _, aim in aim_changes(bench)] == [TWELVE_POINTS[0]]

    @pytest.mark.parametrize(("range_m", "frozen"), [(4.49, True), (4.50, False)])
    def test_threshold_is_4_5_m(self, elf: Path, range_m: float, frozen: bool) -> None:
        bench = Bench(elf, BenchSonar(range_m))
        bench.run(1.5)
        assert (len(aim_changes(bench)) == 1) == frozen
        assert (bench.ranges_cm()[-1] == round(range_m * 100)) == frozen

    def test_one_miss_is_forgiven(self, elf: Path) -> None:
        bench = tracking(elf)
        begun_us = bench.t_us
        misses = len(bench.sonar.triggers_us) + 2
        bench.sonar.range_m = lambda _: None if len(bench.sonar.triggers_us) == misses else 2.0
        bench.run(2.0)
        assert sum(cm == 765 for _, cm in bench.sonar.readings) == 1
        assert len(aim_changes(bench)) == 1
        assert set(bench.ranges_cm(begun_us)) == {200}

    def test_two_misses_in_a_row_start_a_search(self, elf: Path) -> None:
        bench = tracking(elf)
        bench.sonar.range_m = None
        bench.run(1.0)
        assert len(aim_changes(bench)) >= 3
        missed_us = [t_us for t_us, cm in bench.sonar.readings if cm == 765]
        # Two readings of nothing, and not one more, until the range is withdrawn.
        lost = next(
            m
            for m in bench.messages("DISTANCE_SENSOR", since_us=missed_us[0])
            if m.message.current_distance == NO_TARGET_CM
        )
        assert missed_us[1] <= lost.t_us < missed_us[2]

    def test_miss_limit_is_a_parameter(self, elf: Path) -> None:
        bench = tracking(elf)
        assert bench.set_parameter("MISS_LIMIT", 4).param_value == 4
        begun_us = bench.t_us
        bench.sonar.range_m = None
        bench.run(1.0)
        missed_us = [t_us for t_us, cm in bench.sonar.readings if cm == 765]
        lost = next(
            m
            for m in bench.messages("DISTANCE_SENSOR", since_us=begun_us)
            if m.message.current_distance == NO_TARGET_CM
        )
        assert missed_us[3] <= lost.t_us < missed_us[4]

    def test_reports_the_mean_of_the_newest_0_45_s(self, elf: Path) -> None:
        bench = tracking(elf, 3.0)
        begun_us = bench.t_us
        bench.sonar.range_m = lambda t_s: 3.0 - 0.8 * (t_s - begun_us / 1e6)
        bench.run(2.0)
        readings = bench.sonar.readings
        for report in bench.messages("DISTANCE_SENSOR", since_us=begun_us + 1e6):
            heard = [cm for t_us, cm in readings if t_us < report.t_us][-5:]  # one in 100 ms
            assert report.message.current_distance == pytest.approx(sum(heard) / 5, abs=0.51)

    def test_average_never_mixes_what_was_before_a_search(self, elf: Path) -> None:
        bench = tracking(elf, 4.0)
        bench.sonar.range_m = None
        bench.run(0.4)
        begun_us = bench.t_us
        bench.sonar.range_m = 1.0
        bench.run(1.0)
        assert set(bench.ranges_cm(begun_us)) == {NO_TARGET_CM, 100}

    @pytest.mark.parametrize("wild_m", [0.3, 4.2])
    def test_wild_reading_is_kept_out(self, elf: Path, wild_m: float) -> None:
        bench = tracking(elf)
        begun_us = bench.t_us
        chosen = len(bench.sonar.triggers_us) + 3
        bench.sonar.range_m = lambda _: wild_m if len(bench.sonar.triggers_us) == chosen else 2.0
        bench.run(1.0)
        assert round(wild_m, 2) in [round(v, 2) for v in bench.named("SNR_RAW", begun_us)]
        assert set(bench.ranges_cm(begun_us)) == {200}

    def test_newest_single_reading_travels_too(self, elf: Path) -> None:
        bench = tracking(elf, 3.0)
        begun_us = bench.t_us
        bench.sonar.range_m = lambda t_s: 3.0 - 0.8 * (t_s - begun_us / 1e6)
        bench.run(1.0)
        told = bench.messages("NAMED_VALUE_FLOAT", since_us=begun_us + 110_000)
        raw = [heard for heard in told if heard.message.name == "SNR_RAW"]
        assert len(raw) >= 8
        for heard in raw:
            newest_cm = [cm for t_us, cm in bench.sonar.readings if t_us < heard.t_us][-1]
            assert heard.message.value == pytest.approx(newest_cm / 100, abs=0.001)


class TestWhenItScans:
    def test_disarmed_it_looks_straight_ahead_and_goes_on_reporting(self, elf: Path) -> None:
        bench = Bench(elf, armed=False)
        bench.run(1.5)
        begun_us = bench.t_us
        bench.run(1.5)
        assert {aim for _, aim in aim_changes(bench, begun_us)} == {CENTRE}
        assert len(bench.ranges_cm(begun_us)) >= 14  # each ping into the void takes 65 ms

    def test_arming_starts_the_search(self, elf: Path) -> None:
        bench = Bench(elf, armed=False)
        bench.run(1.5)
        bench.armed = True
        begun_us = bench.t_us
        bench.run(2.5)
        assert len(aim_changes(bench, begun_us)) >= 4

    def test_without_an_autopilot_it_scans(self, elf: Path) -> None:
        bench = Bench(elf, armed=False)
        bench.run(1.5)
        bench.armed = None  # heartbeats stop
        begun_us = bench.t_us
        bench.run(8.0)
        assert len(aim_changes(bench, begun_us)) >= 4

    def test_bench_commands_scan_stop_and_aim(self, elf: Path) -> None:
        bench = Bench(elf, armed=False)
        bench.run(1.5)
        assert bench.command(31010, 1).result == 0  # scan
        begun_us = bench.t_us
        bench.run(1.0)
        assert len(aim_changes(bench, begun_us)) >= 3
        assert bench.command(31010, 2).result == 0  # stop
        bench.run(0.1)
        assert aim_changes(bench, bench.t_us - 50_000)[-1][1] == CENTRE
        assert bench.command(183, 1, 1111).result == 0  # hold pan
        assert bench.command(183, 2, 1777).result == 0  # hold tilt
        bench.run(0.1)
        assert aim_changes(bench, bench.t_us - 50_000)[-1][1] == (1111, 1777)

    def test_in_flight_the_bench_has_no_say(self, elf: Path) -> None:
        bench = Bench(elf, armed=True)
        bench.run(1.5)
        assert bench.command(183, 1, 1111).result == 1  # temporarily rejected


class TestReport:
    def test_twenty_a_second_with_less_than_2_ms_jitter(self, reported: Bench) -> None:
        times = [m.t_us for m in reported.messages("DISTANCE_SENSOR", since_us=1e6)]
        intervals = [b - a for a, b in itertools.pairwise(times)]
        assert len(times) == pytest.approx(200, abs=1)
        assert intervals == pytest.approx([50_000] * len(intervals), abs=2_000)

    def test_each_is_on_the_wire_10_ms_after_its_reading(self, reported: Bench) -> None:
        sent_us = [m.t_us for m in reported.messages("DISTANCE_SENSOR", since_us=1e6)]
        read_us = [t_us for t_us, _ in reported.sonar.readings if 1e6 < t_us < sent_us[-1]]
        assert len(read_us) >= 95
        for t_us in read_us:
            assert min(one for one in sent_us if one > t_us) - t_us < 10_000

    def test_says_when_it_was_measured(self, reported: Bench) -> None:
        for report in reported.messages("DISTANCE_SENSOR", since_us=1e6):
            read_us = max(t_us for t_us, _ in reported.sonar.readings if t_us < report.t_us)
            late_ms = read_us / 1e3 - report.message.time_boot_ms
            assert -5 < late_ms < CLOCK_BEGINS_MS + 5

    def test_so_does_each_single_reading_though_it_is_sent_later(self, reported: Bench) -> None:
        """The applet tells a leader's speed from these stamps."""
        values = reported.messages("NAMED_VALUE_FLOAT", since_us=2e6)
        stamps = [m.message.time_boot_ms for m in values if m.message.name == "SNR_RAW"]
        ranges = reported.messages("DISTANCE_SENSOR", since_us=1e6)
        assert len(stamps) >= 70
        assert set(stamps) <= {m.message.time_boot_ms for m in ranges}

    def test_describes_the_sensor(self, reported: Bench) -> None:
        report = reported.messages("DISTANCE_SENSOR")[-1].message
        assert (report.min_distance, report.max_distance) == (20, 765)
        assert (report.type, report.orientation) == (1, 0)  # ultrasound, forward
        assert report.signal_quality == 100
        assert report.horizontal_fov == report.vertical_fov == pytest.approx(math.radians(40))

    def test_quaternion_is_where_the_gimbal_points(self, elf: Path) -> None:
        bench = Bench(elf, armed=False)
        bench.run(1.5)
        pitch_deg, yaw_deg = 12.0, -7.0
        assert bench.command(1000, pitch_deg, yaw_deg).result == 0
        bench.run(0.3)
        w, x, y, z = bench.messages("DISTANCE_SENSOR")[-1].message.quaternion
        # The beam: body x rotated by the quaternion, forward-right-down.
        beam = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        pitch, yaw = math.radians(pitch_deg), math.radians(yaw_deg)
        expected = (
            math.cos(pitch) * math.cos(yaw),
            math.cos(pitch) * math.sin(yaw),
            -math.sin(pitch),
        )
        assert beam == pytest.approx(expected, abs=1e-4)

    @pytest.mark.parametrize("rate_hz", [5, 10, 40])
    def test_rate_is_settable(self, elf: Path, rate_hz: int) -> None:
        bench = tracking(elf, 1.0)
        bench.set_parameter("SONAR_PERIOD", 25)
        assert bench.set_parameter("REPORT_RATE", rate_hz).param_value == rate_hz
        bench.run(0.3)
        begun_us = bench.t_us
        bench.run(1.5)  # 2 s after the change it is stored: an F4 then stands still for a second
        assert len(bench.ranges_cm(begun_us)) == pytest.approx(1.5 * rate_hz, rel=0.05, abs=1)

    def test_still_target_stays_fresh(self, reported: Bench) -> None:
        ranges = reported.ranges_cm(1e6)
        stamps = [m.message.time_boot_ms for m in reported.messages("DISTANCE_SENSOR")]
        assert set(ranges) == {200}
        assert all(b >= a for a, b in itertools.pairwise(stamps))
        assert len(set(stamps)) >= 95  # two reports of each reading

    def test_both_ports_hear_the_same(self, reported: Bench) -> None:
        link = reported.ranges_cm(1e6)
        usb = reported.messages("DISTANCE_SENSOR", CONSOLE_PORT, 1e6)
        assert len(usb) == pytest.approx(len(link), abs=1)
        assert {m.message.current_distance for m in usb} == {200}

    def test_first_report_within_a_second_of_power_on(self, reported: Bench) -> None:
        assert reported.messages("DISTANCE_SENSOR")[0].t_us < 1e6

    def test_heartbeat_once_a_second_honest(self, reported: Bench) -> None:
        beats = reported.messages("HEARTBEAT", since_us=1e6)
        intervals = [b.t_us - a.t_us for a, b in itertools.pairwise(beats)]
        assert intervals == pytest.approx([1e6] * len(intervals), abs=60_000)
        beat = beats[-1].message
        assert (beat.type, beat.autopilot, beat.system_status) == (18, 8, 4)

    def test_two_flights_are_byte_identical(self, elf: Path) -> None:
        def fly() -> bytes:
            bench = Bench(elf, BenchSonar(2.0), noise=321)
            bench.sonar.range_m = lambda t_s: 2.0 if t_s % 2 < 1 else None
            bench.run(4.0)
            return bytes(bench.raw)

        assert fly() == fly()

    def test_the_seed_moves_the_pings_and_not_the_readings(self, elf: Path) -> None:
        def pings(noise: int) -> list[int]:
            bench = Bench(elf, BenchSonar(2.0), noise=noise)
            bench.run(2.0)
            return bench.sonar.triggers_us

        assert pings(3) != pings(700)
