"""The emulated STM32 against its reference manual, by a bare-metal probe of our own."""

import itertools
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from echowing.errors import EchowingError
from echowing.sim.boards import firmware
from echowing.sim.boards.by_name import emulated_board
from echowing.sim.boards.stm32 import Stm32Board
from echowing.sim.world.sonar import MaxSonar

from .emulator_process import PATIENCE_S, Emulator

LINK, USB = 0, 1
BOOTED_US = 5_000
PROBE = Path(__file__).with_name("probe_stm32")
# For each board the family the probe is compiled for, and the compiler's name of its core.
FAMILIES = {
    "bluepill_f103": ("F103", "cortex-m3"),
    "blackpill_f411": ("F411", "cortex-m4"),
    "nucleo_f446": ("F411", "cortex-m4"),
}
# Times from the data sheets: erasing a block of the parameters' flash.
ERASE_US = {"bluepill_f103": 20_000, "blackpill_f411": 1_000_000, "nucleo_f446": 1_000_000}
SLOT_BYTE = 8

Power = Callable[..., Stm32Board]


@pytest.fixture(scope="module", params=FAMILIES)
def probe(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The probe's binary for a board; the folder has the board's name."""
    family, core = FAMILIES[request.param]
    pins = firmware.board(request.param).chip_pins
    elf = tmp_path_factory.mktemp(request.param, numbered=False) / "probe.elf"
    built = subprocess.run(
        [
            *("arm-none-eabi-gcc", f"-mcpu={core}", "-mthumb", "-std=c11", "-O1", "-g"),
            *("-Wall", "-Wextra", "-Werror", "-ffreestanding", "-nostdlib", f"-DPROBE_{family}"),
            *(f"-DLED_PORT='{pins['LED'][0]}'", f"-DLED_BIT={pins['LED'][1:]}"),
            *(f"-DSCL={pins['SCL'][1:]}", f"-DSDA={pins['SDA'][1:]}"),
            *(PROBE / "probe.c", PROBE / "chip.c", "-T", PROBE / "probe.ld", "-o", elf, "-lgcc"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return elf


@pytest.fixture
def power(probe: Path) -> Power:
    """Powers a board with the probe on it, a sonar that hears 1.23 m on its bus."""

    def on(sensor: MaxSonar | None = None, **options: bytes | int) -> Stm32Board:
        sonar = sensor or MaxSonar(lambda _: 1.23)
        board = Stm32Board(sonar, board=probe.parent.name, elf=probe, **options)  # type: ignore[arg-type]
        for pin in (board.type.pan, board.type.tilt):
            board.pin(pin)
        return board

    return on


@pytest.fixture
def board(power: Power) -> Stm32Board:
    """A board that has booted."""
    board = power()
    board.run_until(BOOTED_US)
    assert board.take(LINK) == b"boot\r\n"
    return board


def ask(board: Stm32Board, letters: str, wait_us: float = 20_000) -> str:
    """What the probe answers within a while."""
    board.take(LINK)
    board.feed(LINK, letters.encode())
    board.run_until(board.t_us + wait_us)
    return board.take(LINK).decode()


def test_sizes_are_those_of_binutils(probe: Path) -> None:
    table = subprocess.run(
        ["arm-none-eabi-size", probe], capture_output=True, text=True, check=True
    ).stdout
    text, data, bss = map(int, table.splitlines()[1].split()[:3])
    used = firmware.size(probe, probe.parent.name)
    assert used.flash == text + data
    assert used.ram == data + bss - 0x600  # what the script keeps for heap and stack


class TestPins:
    def test_pulses_are_exact(self, board: Stm32Board) -> None:
        board.run_until(100_000)
        assert board.pin(board.type.pan).width_us == pytest.approx(1380, abs=0.01)
        ask(board, "p", 60_000)
        assert board.pin(board.type.pan).width_us == pytest.approx(1330, abs=0.01)
        assert board.pin(board.type.tilt).width_us == pytest.approx(1500, abs=0.01)
        assert board.pin(board.type.pan).period_us == pytest.approx(20_000, abs=0.01)

    def test_preloaded_pulse_changes_with_the_next_frame(self, board: Stm32Board) -> None:
        board.run_until(50_000)
        board.edges(board.type.pan)  # the first pulse was cut: the pin came after the timer
        board.run_until(100_700)  # in the middle of a pulse, which began at about 100 ms
        ask(board, "p", 60_000)
        edges = board.edges(board.type.pan)
        widths = [later - t for (t, up), (later, _) in itertools.pairwise(edges) if up]
        assert set(map(round, widths)) == {1380, 1330}  # and none of another length between

    def test_led_is_on_the_pin_of_the_board_s_file(self, board: Stm32Board) -> None:
        board.pin(board.type.led)
        assert ask(board, "lll") == ""
        assert [level for _, level in board.edges(board.type.led)] == [True, False, True]

    def test_device_without_a_clock_is_dead(self, board: Stm32Board) -> None:
        assert ask(board, "g") == "0\r\n"


class TestSerialPorts:
    def test_each_port_has_its_own_line(self, board: Stm32Board) -> None:
        board.feed(USB, b"usb")
        assert ask(board, "ACE") == "ACE"
        has_uart = board.type.name == "nucleo_f446"
        assert board.has_port(USB) == has_uart
        assert board.take(USB) == (b"usb" if has_uart else b"")

    def test_rate_is_the_one_the_program_set(self, board: Stm32Board) -> None:
        clock_hz = 8_000_000 if board.type.name == "bluepill_f103" else 16_000_000
        assert board.baud(LINK) == pytest.approx(clock_hz / round(clock_hz / 115_200), rel=1e-4)

    def test_bytes_arrive_and_leave_at_the_rate_of_the_line(self, board: Stm32Board) -> None:
        begun_us = board.t_us
        board.feed(LINK, b"A" * 100)
        board.run_until(begun_us + 30_000)
        times = [t_us for t_us, _ in board.take_timed(LINK)]
        byte_us = 1e7 / board.baud(LINK)
        assert len(times) == 100
        # The first is echoed after it has come in whole, plus its own way out.
        assert times[0] - begun_us == pytest.approx(2 * byte_us, rel=0.2)
        assert (times[-1] - times[0]) / 99 == pytest.approx(byte_us, rel=0.01)

    def test_a_deaf_program_loses_bytes_as_on_the_chip(self, board: Stm32Board) -> None:
        # One byte is kept, and the chip has no second place: of a deaf time's 11.5 bytes a
        # millisecond the rest is lost.
        answer = ask(board, "o" + "x" * 40, 40_000)
        lost = board.overruns(LINK)
        assert lost >= 8
        assert len(answer) == 40 - lost


class TestBus:
    def test_reads_what_the_sonar_measured(self, board: Stm32Board) -> None:
        assert ask(board, "t") == "0\r\n"
        board.run_until(board.t_us + 100_000)
        assert ask(board, "r") == "123\r\n"

    def test_busy_sensor_does_not_acknowledge(self, board: Stm32Board) -> None:
        assert ask(board, "tr", 8_000) == "0\r\nno answer\r\n"
        assert ask(board, "t", 8_000) == "1\r\n"

    def test_transfers_take_the_time_the_clock_rate_says(self, power: Power) -> None:
        asked: list[int] = []

        class Watch(MaxSonar):
            def write(self, t_us: int, address: int, data: bytes) -> bool:
                asked.append(t_us)
                return super().write(t_us, address, data)

        board = power(Watch(lambda _: 1.0))
        board.run_until(BOOTED_US)
        ask(board, "t")
        # From the end of the address to that of the data: 9 bits of 10 us (100 kHz).
        assert asked[-1] - asked[-2] == pytest.approx(90, abs=15)

    def test_held_line_stops_everything_until_nine_clocks(self, board: Stm32Board) -> None:
        board.hold_bus(9)
        assert ask(board, "t") == "1\r\n"
        board.clear_meters()
        assert ask(board, "f") == "1\r\n"  # the data line is high again
        assert (board.meters().bus_clocks, board.meters().bus_stops) == (9, 1)
        assert ask(board, "t") == "0\r\n"

    def test_fewer_clocks_do_not_free_it(self, board: Stm32Board) -> None:
        board.hold_bus(10)
        assert ask(board, "f") == "0\r\n"
        assert ask(board, "t") == "1\r\n"

    def test_unplugged_sonar_answers_nothing(self, power: Power) -> None:
        sonar = MaxSonar(lambda _: 1.0)
        sonar.plugged = False
        board = power(sonar)
        board.run_until(BOOTED_US)
        assert ask(board, "tr") == "1\r\nno answer\r\n"

    def test_error_of_the_device_ends_the_run(self, power: Power) -> None:
        class Broken(MaxSonar):
            def write(self, t_us: int, address: int, data: bytes) -> bool:
                raise EchowingError("the model is broken")

        board = power(Broken(lambda _: 1.0))
        board.run_until(BOOTED_US)
        with pytest.raises(EchowingError, match="the model is broken"):
            ask(board, "t")


class TestFlash:
    def test_is_erased_and_burnt_and_lasts(self, board: Stm32Board, power: Power) -> None:
        erase_us = ERASE_US[board.type.name]
        if erase_us > 100_000:
            return  # the watchdog of the probe does not wait so long: see the next test
        # Ones can only become zeros: 0x5a and then 0xf3 over it make 0x52.
        assert ask(board, "e", erase_us + 10_000) == f"{0x5A & 0xF3}\r\n"
        image = board.power_off()
        assert (image[SLOT_BYTE], image[SLOT_BYTE - 1], len(image)) == (0x52, 0xFF, 2048)
        again = power(eeprom=image)
        again.run_until(BOOTED_US)
        assert again.eeprom() == image

    def test_processor_stands_still_and_the_watchdog_does_not(self, board: Stm32Board) -> None:
        erase_us = ERASE_US[board.type.name]
        begun_us = board.t_us
        board.feed(LINK, b"e" + b"x" * 20)
        board.run_until(begun_us + min(erase_us, 100_000) - 1_000)
        assert board.take(LINK) == b""
        assert board.overruns(LINK) >= 15
        # 120 ms, less than the erase of a large sector takes.
        board.run_until(begun_us + erase_us + 50_000)
        assert board.meters().restarts == (1 if erase_us > 120_000 else 0)

    def test_power_cut_in_mid_erase_spoils_that_block_only(self, power: Power) -> None:
        size = len(power().eeprom())
        board = power(eeprom=bytes([0x20]) * size)
        board.run_until(BOOTED_US)
        ask(board, "e", ERASE_US[board.type.name] / 2)
        image = board.power_off()
        assert set(image[: size // 2]) == {0x75}  # neither the old nor erased
        assert set(image[size // 2 :]) == {0x20}

    def test_erase_takes_as_long_as_it_is_told(self, board: Stm32Board) -> None:
        board.set_erase_us(50_000)
        begun_us = board.t_us
        assert ask(board, "e", 60_000) == "82\r\n"
        assert board.meters().restarts == 0
        assert board.meters().longest_turn_us == pytest.approx(50_000, rel=0.05)
        assert board.t_us < begun_us + 61_000

    def test_store_without_unlocking_is_told(self, board: Stm32Board) -> None:
        with pytest.raises(EchowingError, match=r"writes to flash at 0x080.* without leave"):
            ask(board, "X")

    def test_image_that_does_not_fit_is_refused(self, power: Power) -> None:
        size = len(power().eeprom())
        with pytest.raises(EchowingError, match=f"{size + 1} bytes; the chip has {size}"):
            power(eeprom=bytes(size + 1))


class TestResets:
    PIN, POWER, SOFTWARE, WATCHDOG = 1, 2, 4, 8

    def test_cause_is_told_and_cleared(self, board: Stm32Board) -> None:
        assert ask(board, "q") == f"{self.PIN | self.POWER}\r\n"
        assert ask(board, "q") == "0\r\n"
        assert ask(board, "R") == "boot\r\n"
        assert ask(board, "q") == f"{self.PIN | self.SOFTWARE}\r\n"
        assert board.meters().restarts == 1

    def test_watchdog_restarts_a_hung_program(self, board: Stm32Board) -> None:
        assert board.watchdog_us() == 120_000
        assert ask(board, "w", 119_000) == ""
        assert ask(board, "", 10_000) == "boot\r\n"
        assert ask(board, "q") == f"{self.PIN | self.POWER | self.WATCHDOG}\r\n"
        assert ask(board, "A") == "A"

    def test_fault_reaches_its_handler(self, board: Stm32Board) -> None:
        assert ask(board, "z", 10_000) == "fault\r\n"
        assert ask(board, "", 130_000) == "boot\r\n"

    def test_jump_into_the_boot_loader_is_trapped(self, board: Stm32Board) -> None:
        assert board.boot_loader() is None
        assert ask(board, "b") == ""
        told = board.boot_loader()
        assert told is not None
        for what in ("an interrupt is enabled", "the tick runs", "the watchdog runs"):
            assert what in told
        assert ask(board, "A", 90_000) == ""  # nothing of the program runs

    def test_jump_right_after_a_reset_finds_all_as_it_should_be(self, board: Stm32Board) -> None:
        assert ask(board, "B") == ""
        assert board.boot_loader() == ""


class TestProcessor:
    def test_tick_keeps_the_time(self, board: Stm32Board) -> None:
        board.run_until(100_000)
        before = int(ask(board, "m", 2_000))
        board.run_until(602_000)
        assert int(ask(board, "m", 2_000)) - before == 502

    def test_urgent_interrupt_goes_before_the_one_at_work(self, board: Stm32Board) -> None:
        assert ask(board, "i") == "3\r\n"

    def test_slow_processor_changes_no_other_time(self, power: Power) -> None:
        board = power(slowness=8)
        board.run_until(4 * BOOTED_US)
        assert board.take(LINK) == b"boot\r\n"
        board.run_until(100_000)
        before = int(ask(board, "m", 2_000))
        board.run_until(302_000)
        assert int(ask(board, "m", 2_000)) - before == 202
        assert board.pin(board.type.pan).width_us == pytest.approx(1380, abs=0.01)

    def test_noise_is_the_chip_s_number(self, power: Power) -> None:
        board = power(noise=777)
        board.run_until(BOOTED_US)
        assert ask(board, "n") == "777\r\n"


class TestMeters:
    def test_stack_headroom_sees_the_deepest_call(self, board: Stm32Board) -> None:
        before = board.meters()
        ask(board, "s")
        after = board.meters()
        assert 900 <= before.stack_headroom_bytes - after.stack_headroom_bytes < 1100

    def test_longest_turn_is_the_blocking_one(self, board: Stm32Board) -> None:
        board.run_until(2 * BOOTED_US)
        assert board.meters().longest_turn_us < 200
        ask(board, "d")
        assert board.meters().longest_turn_us == pytest.approx(5000, rel=0.25)
        board.clear_meters()
        board.run_until(board.t_us + 10_000)
        assert board.meters().longest_turn_us < 200


class TestTime:
    def test_two_runs_are_byte_identical(self, power: Power) -> None:
        def run() -> tuple[list[tuple[float, int]], list[tuple[float, bool]], bytes]:
            board = power()
            for step in range(1, 40):
                board.feed(LINK, b"rt" if step % 5 == 0 else b"xi")
                board.run_until(step * 7_000)
                if step == 30:
                    board.feed(LINK, b"R")
            return board.take_timed(LINK), board.edges(board.type.pan), board.eeprom()

        assert run() == run()

    def test_how_time_is_cut_changes_nothing(self, power: Power) -> None:
        def run(step_us: int) -> list[tuple[float, int]]:
            board = power()
            board.feed(LINK, b"ACErtrlpimx")
            for t_us in range(step_us, 120_001, step_us):
                board.run_until(t_us)
            return board.take_timed(LINK)

        assert run(100) == run(1000) == run(40_000)


class TestProcess:
    """`echowing emulator --board`, with the probe for a firmware."""

    def test_talks_on_its_port(self, probe: Path, start: Callable[..., Emulator]) -> None:
        emulator = start("--board", probe.parent.name, "--elf", probe, "--link", "tcpin:0")
        port = int(emulator.told(r"autopilot port: tcp 127\.0\.0\.1:(\d+)"))
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as link:
            link.sendall(b"ACE")
            heard = b""
            while b"ACE" not in heard:
                heard += link.recv(100)

    def test_usb_is_there_or_said_to_be_absent(self, probe: Path) -> None:
        name = probe.parent.name
        emulator = Emulator("--board", name, "--elf", probe, "--usb", "pty", "--duration", "0.01")
        if name == "nucleo_f446":
            assert emulator.told("USB port: (/dev/.+)")
            assert emulator.process.wait(timeout=PATIENCE_S) == 0
        else:
            assert emulator.process.wait(timeout=PATIENCE_S) == 2
            assert f"the emulated {name} has no USB port" in emulator.stop()


class TestBadInput:
    def test_missing_binary_names_the_command(self, tmp_path: Path) -> None:
        with pytest.raises(EchowingError, match="make firmware BOARD=bluepill_f103"):
            emulated_board(
                MaxSonar(lambda _: None), board="bluepill_f103", elf=tmp_path / "none.elf"
            )

    def test_binary_of_another_machine(self, mega_elf: Path) -> None:
        with pytest.raises(EchowingError, match="not built for a nucleo_f446"):
            emulated_board(MaxSonar(lambda _: None), board="nucleo_f446", elf=mega_elf)

    def test_binary_cut_short(self, probe: Path, tmp_path: Path) -> None:
        short = tmp_path / "short.elf"
        short.write_bytes(probe.read_bytes()[:3000])
        with pytest.raises(EchowingError, match="cannot read an ARM program"):
            emulated_board(MaxSonar(lambda _: None), board=probe.parent.name, elf=short)

    def test_binary_that_does_not_fit(self, probe: Path, tmp_path: Path) -> None:
        moved = tmp_path / "moved.elf"
        subprocess.run(
            ["arm-none-eabi-objcopy", "--change-section-lma", ".text=0x20000000", probe, moved],
            capture_output=True,
            check=True,
        )
        with pytest.raises(EchowingError, match="does not fit into an stm32"):
            emulated_board(MaxSonar(lambda _: None), board=probe.parent.name, elf=moved)

    def test_unknown_board_lists_those_there_are(self) -> None:
        with pytest.raises(EchowingError, match="mega, blackpill_f411, bluepill_f103, nucleo_f446"):
            emulated_board(MaxSonar(lambda _: None), board="uno")
