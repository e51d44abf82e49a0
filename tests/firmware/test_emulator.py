"""The emulated board against the chip's data sheet, by a probe sketch."""

import itertools
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from echowing.errors import EchowingError
from echowing.sim.boards import firmware
from echowing.sim.boards.avr import AvrBoard
from echowing.sim.world.sonar import MaxSonar

LINK, USB = 0, 1
BOOTED_US = 20_000

Power = Callable[..., AvrBoard]


@pytest.fixture
def power(probe_elf: Path) -> Power:
    """Powers a board with the probe on it, a sonar that hears 1.23 m on its bus."""

    def on(sensor: MaxSonar | None = None, **options: bytes | int) -> AvrBoard:
        sonar = sensor or MaxSonar(lambda _: 1.23)
        board = AvrBoard(sonar, board="mega", elf=probe_elf, **options)  # type: ignore[arg-type]
        board.pin(board.type.pan)
        board.pin(board.type.tilt)
        return board

    return on


def ask(board: AvrBoard, letters: str, wait_us: float = 20_000) -> str:
    """What the probe answers within a while."""
    board.take(LINK)
    board.feed(LINK, letters.encode())
    board.run_until(board.t_us + wait_us)
    return board.take(LINK).decode()


@pytest.fixture
def board(power: Power) -> AvrBoard:
    """A board that has booted."""
    board = power()
    board.run_until(BOOTED_US)
    assert board.take(LINK) == b"boot\r\n"
    return board


class TestPins:
    def test_pulses_are_exact_to_the_tick(self, board: AvrBoard) -> None:
        board.run_until(100_000)
        ask(board, "p", 60_000)
        # A timer tick is 0.5 us; simavr may date an edge up to 4 cycles (0.25 us) late.
        assert board.pin(board.type.pan).width_us == pytest.approx(1330, abs=0.26)
        assert board.pin(board.type.tilt).width_us == pytest.approx(1500, abs=0.26)
        assert board.pin(board.type.pan).period_us == pytest.approx(20_000, abs=0.26)

    def test_edges_tell_the_same_story_as_the_newest_pulse(self, board: AvrBoard) -> None:
        board.run_until(110_000)
        edges = board.edges(board.type.pan)
        assert [level for _, level in edges] == [True, False] * (len(edges) // 2)
        widths = [down - up for (up, _), (down, _) in zip(edges[::2], edges[1::2], strict=True)]
        assert len(widths) == board.pin(board.type.pan).pulses >= 5
        assert widths[-1] == board.pin(board.type.pan).width_us
        assert board.edges(board.type.pan) == []

    def test_writing_the_port_leaves_a_timer_s_pulses_alone(self, board: AvrBoard) -> None:
        board.pin(board.type.led)
        board.edges(board.type.pan)
        ask(board, "l" * 480, 45_000)  # the LED is on the servos' port
        assert len(board.edges(board.type.led)) == 480
        pan = board.edges(board.type.pan)
        widths = [later - t for (t, up), (later, _) in itertools.pairwise(pan) if up]
        assert len(widths) >= 2
        assert widths == pytest.approx([1380] * len(widths), abs=0.26)


class TestSerialPorts:
    def test_each_port_has_its_own_line(self, board: AvrBoard) -> None:
        board.feed(USB, b"usb")
        assert ask(board, "ABC") == "ABC"
        assert board.take(USB) == b"usb"

    def test_rate_is_the_one_the_program_set(self, board: AvrBoard) -> None:
        # 16 MHz / 8 / 17 and, as Arduino's core prefers for 57600, / 16 / 17.
        assert board.baud(LINK) == pytest.approx(117_647, abs=1)
        assert board.baud(USB) == pytest.approx(58_824, abs=1)

    def test_bytes_arrive_and_leave_at_the_rate_of_the_line(self, board: AvrBoard) -> None:
        begun_us = board.t_us
        board.feed(LINK, b"A" * 100)
        board.run_until(begun_us + 30_000)
        times = [t_us for t_us, _ in board.take_timed(LINK)]
        byte_us = 1e7 / 117_647
        assert len(times) == 100
        # The first is echoed after it has come in whole, plus its own way out.
        assert times[0] - begun_us == pytest.approx(2 * byte_us, rel=0.2)
        assert (times[-1] - times[0]) / 99 == pytest.approx(byte_us, rel=0.01)

    def test_a_deaf_program_loses_bytes_as_on_the_chip(self, board: AvrBoard) -> None:
        # 12 bytes come in a millisecond; the receiver keeps three (data sheet 22.7.1). simavr then
        # hands these out at the line's rate, which costs one more.
        answer = ask(board, "o" + "x" * 30, 40_000)
        assert 8 <= board.overruns(LINK) <= 10
        assert len(answer) == 30 - board.overruns(LINK)


class TestBus:
    def test_reads_what_the_sonar_measured(self, board: AvrBoard) -> None:
        assert ask(board, "t") == "0\r\n"
        board.run_until(board.t_us + 100_000)
        assert ask(board, "r") == "2 0 123\r\n"

    def test_busy_sensor_does_not_acknowledge(self, board: AvrBoard) -> None:
        # While ranging the address is not acknowledged: Wire reports 0 bytes, and error 2.
        assert ask(board, "tr", 5_000) == "0\r\n0\r\n"
        assert ask(board, "t", 5_000) == "2\r\n"

    def test_transfers_take_the_time_the_clock_rate_says(self, power: Power) -> None:
        asked: list[int] = []

        class Watch(MaxSonar):
            def write(self, t_us: int, address: int, data: bytes) -> bool:
                asked.append(t_us)
                return super().write(t_us, address, data)

        board = power(Watch(lambda _: 1.0))
        board.run_until(BOOTED_US)
        ask(board, "t")
        # Address probe and end of the write, with 18 bits of 10 us between them (100 kHz).
        assert asked[-1] - asked[-2] == pytest.approx(180, rel=0.25)

    def test_held_line_stops_everything_until_nine_clocks(self, board: AvrBoard) -> None:
        board.hold_bus(9)
        assert ask(board, "t") == "5\r\n"  # Wire: timed out
        assert ask(board, "f") == "1\r\n"  # the data line is high again
        assert board.meters().bus_clocks == 9
        assert board.meters().bus_stops == 1
        assert ask(board, "t") == "0\r\n"

    def test_fewer_clocks_do_not_free_it(self, board: AvrBoard) -> None:
        board.hold_bus(10)
        assert ask(board, "f") == "0\r\n"
        assert ask(board, "t") == "5\r\n"

    def test_error_of_the_device_ends_the_run(self, power: Power) -> None:
        class Broken(MaxSonar):
            def write(self, t_us: int, address: int, data: bytes) -> bool:
                raise EchowingError("the model is broken")

        board = power(Broken(lambda _: 1.0))
        board.run_until(BOOTED_US)
        with pytest.raises(EchowingError, match="the model is broken"):
            ask(board, "t")


class TestMemory:
    def test_write_takes_its_time_and_lasts(self, board: AvrBoard, power: Power) -> None:
        assert ask(board, "e?", 3_000) == "busy\r\n"
        board.run_until(board.t_us + 500)
        assert ask(board, "?", 3_000) == "ready\r\n"
        image = board.power_off()
        assert image[7] == 0x5A
        again = power(eeprom=image)
        again.run_until(BOOTED_US)
        assert again.eeprom()[7] == 0x5A

    def test_power_cut_in_mid_write_loses_that_byte_only(self, power: Power) -> None:
        board = power(eeprom=bytes(range(16)))
        board.run_until(BOOTED_US)
        ask(board, "e", 2_000)
        assert board.power_off()[:16] == bytes([*range(7), 0xFF, *range(8, 16)])

    def test_image_that_does_not_fit_is_refused(self, power: Power) -> None:
        with pytest.raises(EchowingError, match="4097 bytes; the chip has 4096"):
            power(eeprom=bytes(4097))


class TestMeters:
    def test_stack_headroom_sees_the_deepest_call(self, board: AvrBoard) -> None:
        before = board.meters()
        ask(board, "s")
        after = board.meters()
        assert 1000 <= before.stack_headroom_bytes - after.stack_headroom_bytes < 1100
        stack_used = board.type.ram_bytes - after.static_bytes - after.stack_headroom_bytes
        assert 1000 < stack_used < 1200

    def test_longest_turn_is_the_blocking_one(self, board: AvrBoard) -> None:
        assert board.meters().longest_turn_us < 200
        ask(board, "d")
        assert board.meters().longest_turn_us == pytest.approx(5000, rel=0.25)
        board.clear_meters()
        board.run_until(board.t_us + 10_000)
        assert board.meters().longest_turn_us < 200

    def test_watchdog_restarts_a_hung_program(self, board: AvrBoard) -> None:
        # Set to 120 ms nominal (data sheet table 12-2: 16384 cycles of 128 kHz).
        assert ask(board, "w", 120_000) == ""
        assert ask(board, "A", 30_000) == "boot\r\n"
        assert board.meters().restarts == 1
        assert ask(board, "A") == "A"

    def test_dead_program_is_told(self, board: AvrBoard) -> None:
        with pytest.raises(EchowingError, match=r"stopped at 0\.02.* interrupts off"):
            ask(board, "z")


class TestTime:
    def test_two_runs_are_byte_identical(self, power: Power) -> None:
        def run() -> tuple[list[tuple[float, int]], list[tuple[float, bool]], bytes]:
            board = power()
            for step in range(1, 60):
                board.feed(LINK, b"rt" if step % 5 == 0 else b"xe")
                board.run_until(step * 7_000)
            return board.take_timed(LINK), board.edges(board.type.pan), board.eeprom()

        assert run() == run()

    def test_how_time_is_cut_changes_nothing(self, power: Power) -> None:
        def run(step_us: int) -> list[tuple[float, int]]:
            board = power()
            board.feed(LINK, b"ABCrtr")
            for t_us in range(step_us, 120_001, step_us):
                board.run_until(t_us)
            return board.take_timed(LINK)

        assert run(1000) == run(40_000)

    def test_offset_is_the_time_of_power_on(self, power: Power) -> None:
        board = power(offset_us=5_000_000)
        assert board.t_us == 5_000_000
        board.run_until(5_000_000 + BOOTED_US)
        assert board.take(LINK) == b"boot\r\n"


class TestBadInput:
    def test_missing_binary_names_the_command(self, tmp_path: Path) -> None:
        with pytest.raises(EchowingError, match="make firmware BOARD=mega"):
            AvrBoard(MaxSonar(lambda _: None), board="mega", elf=tmp_path / "none.elf")

    def test_something_else_than_a_binary(self, tmp_path: Path) -> None:
        (tmp_path / "x.elf").write_text("not an ELF, but as long as one: " * 9)
        with pytest.raises(EchowingError, match="not an ELF file"):
            AvrBoard(MaxSonar(lambda _: None), board="mega", elf=tmp_path / "x.elf")

    def test_binary_of_another_machine(self) -> None:
        with pytest.raises(EchowingError, match="not built for a mega"):
            AvrBoard(MaxSonar(lambda _: None), board="mega", elf=Path("/bin/true").resolve())


class TestBoardTable:
    def test_chip_s_pins_are_those_that_arduino_numbers(self) -> None:
        # The board's file has both; the core's variant says where a number is.
        variant = Path("/usr/share/arduino/hardware/arduino/avr/variants/mega/pins_arduino.h")
        places = {
            number: f"{port}{bit}"
            for port, bit, number in re.findall(
                r"// P(\w) (\d) \*\* (\d+) \*\*", variant.read_text()
            )
        }
        mega = firmware.BOARDS["mega"]
        assert mega.chip_pins == {role: places[mega.pins[role]] for role in mega.chip_pins}
        assert set(mega.chip_pins) == {"PAN", "TILT", "SDA", "SCL", "LED"}
        # Serial1, of which Arduino's numbers are these.
        assert (mega.pins["RX"], mega.pins["TX"], mega.uarts["autopilot"]) == ("19", "18", "1")
