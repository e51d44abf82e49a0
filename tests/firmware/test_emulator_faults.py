"""The flashed binary, emulated: a sonar in trouble, memory in trouble, and what the LED says."""

import random
from pathlib import Path

import pytest

from .bench import BOARD, IS_STM32, Bench, BenchSonar

pytestmark = pytest.mark.seconds(16)

NO_TARGET_CM = 766
STALE_US = 300_000
ACTIVE, CRITICAL = 4, 5
STORE_AFTER_S = 2.0
# Freed at the first attempt. On the Mega by nine clocks and the one of the STOP; the STM32's core
# makes twenty of its own when the bus is begun again and the data line is low.
FREED_BY = (20, 0) if IS_STM32 else (10, 1)
# The Mega's bus gives up after 1.2 ms. The core of the STM32 counts whole milliseconds, of which
# three pass at most; then comes the recovery.
HELD_BUS_TURN_US = 4_000 if IS_STM32 else 2_000
MEMORY_BYTES = 2 * BOARD.slot or 4096  # the Mega's EEPROM
STORED_S = 4.0  # the pause, and 3.3 ms for each of a hundred-odd bytes, with room


class TestSonarInTrouble:
    def test_unplugged_falls_silent_after_300_ms_and_says_so(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(2.0)
        bench.sonar.plugged = False
        begun_us = bench.t_us
        bench.run(3.0)
        last_reading_us = bench.sonar.readings[-1][0]
        reports = bench.messages("DISTANCE_SENSOR", since_us=begun_us)
        assert reports[-1].t_us - last_reading_us < STALE_US + 10_000
        assert reports[-1].t_us - last_reading_us > STALE_US - 60_000
        assert "Echowing: sonar does not answer" in bench.texts(since_us=begun_us)
        assert bench.messages("HEARTBEAT")[-1].message.system_status == CRITICAL
        assert bench.named("SNR_STATE")[-1] == 3

    def test_returned_it_says_so_and_reports_again(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(1.0)
        bench.sonar.plugged = False
        bench.run(3.0)
        bench.sonar.plugged = True
        begun_us = bench.t_us
        bench.run(1.5)
        assert bench.texts(since_us=begun_us) == ["Echowing: sonar answers again"]
        assert bench.messages("HEARTBEAT")[-1].message.system_status == ACTIVE
        assert bench.ranges_cm(begun_us)[-1] == 200

    def test_never_there(self, elf: Path) -> None:
        sonar = BenchSonar(2.0)
        sonar.plugged = False
        bench = Bench(elf, sonar)
        bench.run(3.0)
        assert bench.ranges_cm() == []
        assert "Echowing: sonar does not answer" in bench.texts()
        assert bench.messages("HEARTBEAT")[-1].message.system_status == CRITICAL
        assert bench.board.meters().restarts == 0

    def test_stuck_value_is_reported_as_long_as_it_is_measured(self, elf: Path) -> None:
        # Never judged by equality: a still target repeats its centimetre.
        bench = Bench(elf, BenchSonar(2.0))
        bench.sonar.raw_cm = 123
        bench.run(5.0)
        assert set(bench.ranges_cm(1e6)) == {123}
        assert len(bench.ranges_cm(1e6)) == pytest.approx(80, abs=2)

    @pytest.mark.parametrize("raw_cm", [0, 19, 766, 0x8000, 0xFFFF])
    def test_impossible_values_are_no_readings(self, elf: Path, raw_cm: int) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(1.0)
        bench.sonar.raw_cm = raw_cm
        begun_us = bench.t_us
        bench.run(1.5)
        reports = bench.messages("DISTANCE_SENSOR", since_us=begun_us)
        assert {m.message.current_distance for m in reports} <= {200, NO_TARGET_CM}
        assert reports[-1].t_us < begun_us + STALE_US + 10_000

    def test_first_read_after_power_on_is_thrown_away(self, elf: Path) -> None:
        # It is part information, here one that could be taken for a distance of 1 m.
        bench = Bench(elf, BenchSonar(2.0))
        bench.sonar.part_information = 100
        bench.run(1.0)
        assert bench.sonar.read_before_ranging
        assert set(bench.ranges_cm()) <= {200, NO_TARGET_CM}
        assert bench.named("SNR_RAW")[0] == 2.0

    def test_far_target_is_waited_for(self, elf: Path) -> None:
        # 7 m take 61 ms: longer than the reading is asked for, and no fault.
        bench = Bench(elf, BenchSonar(7.0))
        bench.run(3.0)
        assert bench.texts() == ["Echowing: started, power on"]
        assert set(bench.named("SNR_RAW")) == {7.0}
        assert len(bench.named("SNR_RAW")) > 2.5 / 0.105

    def test_held_data_line_is_freed_by_nine_clocks_and_a_stop(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(1.0)
        bench.board.clear_meters()
        bench.board.hold_bus(9)
        begun_us = bench.t_us
        bench.run(1.0)
        meters = bench.board.meters()
        assert (meters.bus_clocks, meters.bus_stops) == FREED_BY
        assert meters.longest_turn_us < HELD_BUS_TURN_US
        assert bench.ranges_cm(begun_us)[-1] == 200
        assert len(bench.ranges_cm(begun_us + 500_000)) >= 9

    def test_wild_readings_one_in_ten_do_not_shake_the_average(self, elf: Path) -> None:
        noise = random.Random(4)
        bench = Bench(elf, BenchSonar(2.0))
        bench.sonar.range_m = lambda _: 4.2 if noise.random() < 0.1 else 2.0
        bench.run(10.0)
        ranges = bench.ranges_cm(1e6)
        assert sum(cm == 200 for cm in ranges) > 0.9 * len(ranges)


class TestMemory:
    def test_change_outlives_a_power_cut_once_stored(self, elf: Path) -> None:
        bench = Bench(elf)
        bench.run(0.5)
        bench.set_parameter("SCAN_DWELL", 450)
        bench.run(STORED_S)
        assert "Echowing: parameters stored" in bench.texts()
        assert self.dwell_after(elf, bench.board.power_off()) == 450

    def test_not_stored_before_2_s_of_calm(self, elf: Path) -> None:
        bench = Bench(elf)
        bench.run(0.5)
        before = bench.board.eeprom()
        for dwell in (400, 410, 420):
            bench.set_parameter("SCAN_DWELL", dwell)
            bench.run(STORE_AFTER_S - 0.3)
        assert bench.board.eeprom() == before

    def test_armed_it_waits_for_the_landing(self, elf: Path) -> None:
        bench = Bench(elf, armed=True)
        bench.run(1.5)
        before = bench.board.eeprom()
        bench.set_parameter("SCAN_DWELL", 450)
        bench.run(STORED_S)
        assert bench.board.eeprom() == before
        bench.armed = False
        bench.run(STORED_S)
        assert bench.board.eeprom() != before

    @pytest.mark.mega  # flash blocks are another matter: on_stm32.py
    def test_power_cut_at_any_moment_leaves_the_old_set_or_the_new(self, elf: Path) -> None:
        bench = Bench(elf)
        bench.run(0.5)
        bench.set_parameter("SCAN_DWELL", 410)
        bench.run(STORED_S)
        bench.set_parameter("SCAN_DWELL", 420)
        bench.run(STORE_AFTER_S - 0.05)
        outcomes: list[float] = []
        images: list[bytes] = []
        for _ in range(120):  # every 5 ms from before the first byte until after the last
            bench.run(0.005)
            image = bench.board.eeprom()
            if not images or image != images[-1]:
                images.append(image)
        assert len(images) > 5
        for image in images[:: max(1, len(images) // 16)] + images[-1:]:
            outcomes.append(self.dwell_after(elf, image))
        assert set(outcomes) == {410, 420}
        assert outcomes == sorted(outcomes)

    @staticmethod
    def dwell_after(elf: Path, image: bytes) -> float:
        """SCAN_DWELL of a board booted with that memory, which it must not complain of."""
        again = Bench(elf, eeprom=image)
        again.run(0.3)
        assert again.texts() == ["Echowing: started, power on"]
        return float(again.set_parameter("SCAN_DWELL", float("nan")).param_value)

    def test_corrupt_memory_falls_back_to_defaults_and_says_so(self, elf: Path) -> None:
        bench = Bench(elf, eeprom=random.Random(5).randbytes(MEMORY_BYTES))
        bench.run(1.0)
        assert "Echowing: memory corrupt, defaults in use" in bench.texts()
        assert bench.set_parameter("SCAN_DWELL", float("nan")).param_value == 300

    def test_one_flipped_bit_is_found(self, elf: Path) -> None:
        bench = Bench(elf)
        bench.run(0.5)
        bench.set_parameter("SCAN_DWELL", 450)
        bench.run(STORED_S)
        image = bytearray(bench.board.power_off())
        used = [place for place, byte in enumerate(image) if byte != 0xFF]
        image[used[len(used) // 2]] ^= 0x10
        again = Bench(elf, eeprom=bytes(image))
        again.run(1.0)
        assert "Echowing: memory corrupt, defaults in use" in again.texts()


class TestLight:
    """LED codes: sixteen steps of 125 ms, over and over."""

    @pytest.mark.parametrize(
        ("range_m", "plugged", "armed", "pattern"),
        [
            (None, True, True, 0x0F0F),  # searching: slow blink
            (2.0, True, True, 0xFFFF),  # tracking: steady
            (2.0, False, True, 0x0015),  # sonar fault: three flashes
            (2.0, True, None, 0x0005),  # no autopilot: two flashes
        ],
    )
    def test_codes(
        self, elf: Path, range_m: float | None, plugged: bool, armed: bool | None, pattern: int
    ) -> None:
        sonar = BenchSonar(range_m)
        sonar.plugged = plugged
        bench = Bench(elf, sonar, armed=armed)
        bench.run(4.0)
        seen = 0
        for step in range(16):
            bench.board.run_until(4e6 + step * 125_000 + 60_000)
            lit = bench.board.pin(bench.board.type.led).level == (BOARD.led_on == "HIGH")
            seen |= lit << step
        assert seen == pattern
