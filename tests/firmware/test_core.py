"""The core's own unit tests, run by CTest: on this machine with the sanitizers, and on a Cortex-M3.

And the parts of the board layer that no test here can run are at least compiled.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SKETCH = ROOT / "firmware" / "echowing"
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
    run("cmake", "-S", "tests/firmware", "-B", build, "-G", "Ninja", *options)
    run("cmake", "--build", build)
    run("ctest", "--test-dir", build, "--output-on-failure", "--no-tests=error")


def test_core_behaves_and_the_sanitizers_are_silent() -> None:
    build_and_test(ROOT / "build" / "core_tests")


def test_core_behaves_the_same_on_a_cortex_m3() -> None:
    toolchain = ROOT / "tests" / "firmware" / "cortex_m3" / "toolchain.cmake"
    build_and_test(ROOT / "build" / "core_tests_m3", "--toolchain", toolchain)


@pytest.mark.parametrize("board", STM32_BOARDS)
def test_sketch_and_board_layer_compile_for_stm32(board: str) -> None:
    """Against declarations of stm32duino's calls, with the standard that it uses."""
    if not (SKETCH / "src" / "mavlink" / "echowing" / "mavlink.h").exists():
        run("cmake", "-S", "firmware/host", "-B", "build/host", "-G", "Ninja")
        run("cmake", "--build", "build/host", "--target", "mavlink_headers")
    defines = [f"-D{name}" for name in ("ARDUINO_ARCH_STM32", *STM32_BOARDS[board])]
    sources = [SKETCH / "echowing.ino", *sorted((SKETCH / "src").glob("*/*.cpp"))]
    run(
        "arm-none-eabi-g++",
        *("-mcpu=cortex-m3", "-mthumb", "-std=gnu++17", "-fsyntax-only"),
        *("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"),
        *defines,
        "-I",
        ROOT / "tests" / "firmware" / "stm32_declarations",
        *("-x", "c++"),
        *sources,
    )


def test_a_pin_used_twice_does_not_compile(tmp_path: Path) -> None:
    """The compile-time check of the pin table bites."""
    table = (SKETCH / "src" / "board" / "pin_table.h").read_text()
    copy = tmp_path / "src"
    shutil.copytree(SKETCH / "src", copy)
    (copy / "board" / "pin_table.h").write_text(table.replace("(PA6, PA7,", "(PA6, PA6,"))
    done = subprocess.run(
        [
            *("arm-none-eabi-g++", "-mcpu=cortex-m3", "-mthumb", "-std=gnu++17", "-fsyntax-only"),
            *("-DARDUINO_ARCH_STM32", "-DSTM32F1xx", "-DARDUINO_BLUEPILL_F103C8"),
            *("-I", str(ROOT / "tests" / "firmware" / "stm32_declarations")),
            str(copy / "board" / "wire_bus.cpp"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "uses a pin of this board twice" in done.stderr
