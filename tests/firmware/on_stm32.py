"""The firmware on an STM32 board, built with the official core: what only these boards do.

`make test-stm32` runs this for each of them, with the tests of the emulated Mega's firmware. It is
no part of `make test`, which has no such core.
"""

import itertools
from pathlib import Path

import pytest

from echowing.sim.boards.coprocessor import AUTOPILOT_PORT
from echowing.sim.boards.stm32 import Stm32Board

from .bench import BOARD, CONSOLE_PORT, Bench, BenchSonar

ERASE_LONGEST_US = {"stm32f103": 40_000}.get(BOARD.chip, 2_000_000)  # data sheets
BLOCK = BOARD.slot
REBOOT, INTO_BOOTLOADER = 246, 3
LIT = BOARD.led_on == "HIGH"
STEP_US = 125_000  # of the light's patterns


def powered(elf: Path, range_m: float | None = 2.0, eeprom: bytes | None = None) -> Stm32Board:
    """A board under power with a sonar, at its own pace."""
    board = Stm32Board(BenchSonar(range_m), board=BOARD.name, elf=elf, eeprom=eeprom)
    board.pin(board.type.led)
    return board


WATCH_US = 5_000


def changes(
    elf: Path, stored: bytes, *, from_us: float, until_us: float, step_us: float
) -> list[tuple[float, bytes]]:
    """When the memory changes, and to what, while SCAN_DWELL 420 is stored over an older set."""
    bench = Bench(elf, eeprom=stored)
    bench.run(0.5)
    bench.set_parameter("SCAN_DWELL", 420)
    bench.board.run_until(from_us)
    found = [(bench.t_us, bench.board.eeprom())]
    while bench.t_us < until_us:
        bench.board.run_until(bench.t_us + step_us)
        image = bench.board.eeprom()
        if image != found[-1][1]:
            found.append((bench.t_us, image))
    return found


class TestStart:
    def test_light_and_watchdog_are_on_at_once(self, elf: Path) -> None:
        board = powered(elf)
        board.run_until(3_000)  # the clock has not been started yet
        assert board.pin(board.type.led).level == LIT
        assert board.watchdog_us() == pytest.approx(500_000, rel=0.01)

    def test_it_speaks_within_a_second(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(1.0)
        assert "Echowing: started, power on" in bench.texts(CONSOLE_PORT)
        assert bench.ranges_cm()[-1] == 200
        assert bench.board.meters().restarts == 0

    def test_speed_of_the_port_is_within_a_percent(self, elf: Path) -> None:
        board = powered(elf)
        board.run_until(500_000)
        assert board.baud(AUTOPILOT_PORT) == pytest.approx(115_200, rel=0.01)

    def test_without_its_crystal_it_flashes_five_times_and_starts_again(self, elf: Path) -> None:
        board = powered(elf)
        board.break_crystal()
        board.run_until(4_300_000)
        edges = board.edges(board.type.led)
        if BOARD.name == "nucleo_f446":  # its core then takes the chip's own oscillator
            assert board.meters().restarts == 0
            assert board.take(AUTOPILOT_PORT) != b""
            return
        # The light is on from the start; the edges are the ends of the five flashes, the begin of
        # four of them, and the restart at the end of the pause.
        spans = [later - t for (t, _), (later, _) in itertools.pairwise(edges[:10])]
        assert spans == pytest.approx([STEP_US] * 8 + [7 * STEP_US], rel=0.01)
        assert edges[0][1] != LIT
        assert board.meters().restarts == 2
        assert board.take(AUTOPILOT_PORT) == b""


class TestBootLoader:
    def test_is_entered_with_everything_as_after_a_reset(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(1.2)
        assert isinstance(bench.board, Stm32Board)
        bench.command(REBOOT, INTO_BOOTLOADER)
        bench.run(1.0)
        assert bench.board.boot_loader() == ""
        assert bench.board.meters().restarts == 1

    def test_is_left_by_power_and_not_entered_again(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        bench.run(1.2)
        assert isinstance(bench.board, Stm32Board)
        bench.command(REBOOT, 1)
        bench.run(1.5)
        assert bench.board.boot_loader() is None
        assert bench.ranges_cm()[-1] == 200


class TestMemory:
    def test_watchdog_is_long_only_while_the_flash_is_erased(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        board = bench.board
        assert isinstance(board, Stm32Board)
        board.set_erase_us(ERASE_LONGEST_US)
        bench.run(0.5)
        bench.set_parameter("SCAN_DWELL", 450)
        seen = []
        for _ in range(round((2.5e6 + ERASE_LONGEST_US) / WATCH_US)):
            board.run_until(board.t_us + WATCH_US)
            seen.append(round(board.watchdog_us() / 1e6, 1))
        assert [limit_s for limit_s, _ in itertools.groupby(seen)] == [0.5, 8.0, 0.5]
        assert seen.count(8.0) * WATCH_US == pytest.approx(ERASE_LONGEST_US, abs=3 * WATCH_US)
        assert board.meters().restarts == 0

    def test_the_longest_erase_is_survived(self, elf: Path) -> None:
        bench = Bench(elf, BenchSonar(2.0))
        assert isinstance(bench.board, Stm32Board)
        bench.board.set_erase_us(ERASE_LONGEST_US)
        bench.run(0.5)
        bench.set_parameter("SCAN_DWELL", 450)
        bench.run(2.5 + ERASE_LONGEST_US / 1e6)
        assert bench.board.meters().restarts == 0
        again = Bench(elf, BenchSonar(2.0), eeprom=bench.board.power_off())
        again.run(0.5)
        assert again.set_parameter("SCAN_DWELL", float("nan")).param_value == 450

    def test_power_cut_at_any_moment_leaves_the_old_set_or_the_new(self, elf: Path) -> None:
        bench = Bench(elf)
        bench.run(0.5)
        bench.set_parameter("SCAN_DWELL", 410)
        bench.run(2.5 + ERASE_LONGEST_US / 1e6)
        stored = bench.board.eeprom()
        until_us = 3.5e6 + ERASE_LONGEST_US
        ended_us = changes(elf, stored, from_us=1e6, until_us=until_us, step_us=WATCH_US)[-1][0]
        images = [stored]
        images += [
            image
            for _, image in changes(
                elf, stored, from_us=ended_us - 3 * WATCH_US, until_us=ended_us, step_us=20
            )
        ]
        assert len(images) > 20
        chosen = images[:: len(images) // 12] + images[-1:]
        outcomes = [self.dwell_after(elf, image) for image in chosen]
        assert set(outcomes) == {410, 420}
        assert outcomes == sorted(outcomes)

    @staticmethod
    def dwell_after(elf: Path, image: bytes) -> float:
        """SCAN_DWELL of a board booted with that memory, which it must not complain of."""
        again = Bench(elf, eeprom=image)
        again.run(0.3)
        assert again.texts(CONSOLE_PORT) == ["Echowing: started, power on"]
        return float(again.set_parameter("SCAN_DWELL", float("nan")).param_value)

    def test_blocks_are_the_last_two_of_the_flash(self, elf: Path) -> None:
        bench = Bench(elf)
        bench.run(0.5)
        assert len(bench.board.eeprom()) == 2 * BLOCK
        assert set(bench.board.eeprom()) == {0xFF}  # the program reaches into neither
