"""The core's own unit tests, run by CTest: on this machine with the sanitizers, and on a Cortex-M3.

And the parts of the board layer that no test here can run are at least compiled.
"""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

pytestmark = pytest.mark.seconds(40)
ROOT = Path(__file__).resolve().parents[2]
SKETCH = ROOT / "firmware" / "echowing"
MAVLINK_HEADERS = SKETCH / "src" / "mavlink" / "echowing" / "mavlink.h"
DECLARATIONS = ROOT / "tests" / "firmware" / "stm32_declarations"
STM32_BOARDS = {
    "blackpill_f411": ("STM32F4xx", "ARDUINO_BLACKPILL_F411CE", "USBD_USE_CDC"),
    "bluepill_f103": ("STM32F1xx", "ARDUINO_BLUEPILL_F103C8", "USBD_USE_CDC"),
    "nucleo_f446": ("STM32F4xx", "ARDUINO_NUCLEO_F446RE"),
}


def run(*command: str | Path) -> str:
    """Run a tool of this environment; its words, if it fails, are the test's failure."""
    tool = shutil.which(str(command[0]), path=str(Path(sys.executable).parent)) or command[0]
    done = subprocess.run(
        [tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build_and_test(build: Path, *options: str | Path) -> None:
    """Build and run them; the headers, which other tests compile with, stay as they are."""
    assert MAVLINK_HEADERS.exists(), "run `make core` first: it makes the MAVLink headers"
    headers_made = MAVLINK_HEADERS.stat().st_mtime_ns
    run("cmake", "-S", "tests/firmware", "-B", build, "-G", "Ninja", *options)
    run("cmake", "--build", build)
    run("ctest", "--test-dir", build, "--output-on-failure", "--no-tests=error")
    assert MAVLINK_HEADERS.stat().st_mtime_ns == headers_made


def test_core_behaves_and_the_sanitizers_are_silent() -> None:
    build_and_test(ROOT / "build" / "core_tests")


@pytest.mark.long
def test_core_behaves_the_same_on_a_cortex_m3() -> None:
    toolchain = ROOT / "tests" / "firmware" / "cortex_m3" / "toolchain.cmake"
    build_and_test(ROOT / "build" / "core_tests_m3", "--toolchain", toolchain)


@pytest.mark.parametrize("board", STM32_BOARDS)
def test_sketch_and_board_layer_compile_for_stm32(board: str) -> None:
    """Against declarations of stm32duino's calls, with the standard that it uses."""
    defines = [f"-D{name}" for name in ("ARDUINO_ARCH_STM32", *STM32_BOARDS[board])]
    compile_stm32(SKETCH / "echowing.ino", *sources_of("board"), defines=defines)


def test_core_compiles_for_stm32() -> None:
    """Once: it knows no board, and compiles without any of their names."""
    compile_stm32(*sources_of("core"))


def sources_of(layer: str) -> list[Path]:
    found = sorted((SKETCH / "src" / layer).glob("*.cpp"))
    assert found
    return found


def compile_stm32(*sources: Path, defines: Sequence[str] = ()) -> None:
    run(
        "arm-none-eabi-g++",
        *("-mcpu=cortex-m3", "-mthumb", "-std=gnu++17", "-fsyntax-only"),
        *("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"),
        *defines,
        "-I",
        DECLARATIONS,
        *("-x", "c++"),
        *sources,
    )


def compile_changed(
    board: str, source: str, folder: Path, old: str, new: str
) -> subprocess.CompletedProcess[str]:
    """Compile a file of the board layer for a board in whose file something is changed."""
    copy = folder / "src"
    shutil.copytree(SKETCH / "src", copy)
    file = copy / "board" / "boards" / f"{board}.h"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    return subprocess.run(
        [
            *("arm-none-eabi-g++", "-mcpu=cortex-m3", "-mthumb", "-std=gnu++17", "-fsyntax-only"),
            *(f"-D{name}" for name in ("ARDUINO_ARCH_STM32", *STM32_BOARDS[board])),
            *("-I", str(DECLARATIONS)),
            str(copy / "board" / source),
        ],
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_pin_used_twice_does_not_compile(tmp_path: Path) -> None:
    done = compile_changed(
        "bluepill_f103", "wire_bus.cpp", tmp_path, "PIN_TILT PA7", "PIN_TILT PA6"
    )
    assert done.returncode != 0
    assert "uses a pin twice" in done.stderr


@pytest.mark.parametrize("board", STM32_BOARDS)
@pytest.mark.parametrize("output", ["PA_7", "PA_6"])  # TIM1's channel 1N, and pan's channel
def test_an_output_that_the_core_stops_at_does_not_compile(
    tmp_path: Path, board: str, output: str
) -> None:
    done = compile_changed(board, "servo_pwm_stm32.cpp", tmp_path, "PA_7_ALT1", output)
    assert done.returncode != 0
    assert "the tilt output is not that channel of the timer" in done.stderr


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("PROGRAM_BYTES 262144", "PROGRAM_BYTES 262145", "sectors from 5 on have 128 kB"),
        ("SLOT_BYTES 131072", "SLOT_BYTES 64", "a slot is larger than its block"),
    ],
)
def test_memory_that_is_not_the_chip_s_does_not_compile(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    done = compile_changed("blackpill_f411", "lasting_memory_stm32.cpp", tmp_path, old, new)
    assert done.returncode != 0
    assert words in done.stderr


@pytest.mark.parametrize("board", STM32_BOARDS)
def test_servo_pulses_start_on_pins_that_the_core_takes(tmp_path: Path, board: str) -> None:
    """The core's look-up of a pin, on this machine: with the pin's number it would hang."""
    program = tmp_path / "start_pwm"
    run(
        *("c++", "-std=gnu++17", "-Wall", "-Wextra", "-Werror", "-o", program),
        *(f"-D{name}" for name in ("ARDUINO_ARCH_STM32", *STM32_BOARDS[board])),
        *("-I", DECLARATIONS, "-I", SKETCH / "src"),
        *(DECLARATIONS / name for name in ("start_pwm.cpp", "pwm_pins.cpp")),
        SKETCH / "src" / "board" / "servo_pwm_stm32.cpp",
    )
    assert run(program) == "TIM3 channel 1 on pin 0x006\nTIM3 channel 2 on pin 0x107\n"
    hung = subprocess.run([program, "by-number"], capture_output=True, text=True, check=False)
    assert hung.returncode == 3
    assert "the core stops here: pin 0x007 is not channel 2 of TIM3" in hung.stdout
