"""What the tests of the board's binary share: the binary, a probe sketch, a fake programmer."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from echowing.sim.boards import firmware

from .bench import BOARD
from .emulator_process import Emulator
from .fake_programmer import FakeProgrammer
from .fake_rom_loader import FakeRomLoader

BUILD = firmware.REPOSITORY / "firmware" / "tools" / "build.py"


@pytest.fixture(scope="session")
def probe_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The probe sketch, compiled for the Mega as the firmware is."""
    output = tmp_path_factory.mktemp("probe")
    sketch = Path(__file__).with_name("probe")
    built = subprocess.run(
        [sys.executable, BUILD, "mega", "--sketch", sketch, "--output", output],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return output


@pytest.fixture(scope="session")
def probe_elf(probe_folder: Path) -> Path:
    """The probe's binary."""
    return probe_folder / "echowing.elf"


@pytest.fixture(scope="session")
def mega_elf() -> Path:
    """The firmware as `make firmware BOARD=mega` leaves it."""
    elf = firmware.elf_path("mega")
    firmware.check_elf(elf, "mega")
    return elf


@pytest.fixture(scope="session")
def elf() -> Path:
    """The firmware of the board under test (see bench.py): the Mega's, if nothing else is asked."""
    path = firmware.elf_path(BOARD.name)
    firmware.check_elf(path, BOARD.name)
    return path


@pytest.fixture
def programmer() -> Iterator[FakeProgrammer]:
    """A Mega's bootloader on a pseudo-terminal."""
    fake = FakeProgrammer()
    yield fake
    fake.close()


@pytest.fixture
def rom_loader() -> Iterator[FakeRomLoader]:
    """A Blue Pill's boot loader on a pseudo-terminal."""
    fake = FakeRomLoader()
    yield fake
    fake.close()


@pytest.fixture
def start(mega_elf: Path) -> Iterator[Callable[..., Emulator]]:
    """Starts emulators, and stops them after the test."""
    started: list[Emulator] = []

    def run(*options: str | Path) -> Emulator:
        started.append(Emulator(*options))
        return started[-1]

    yield run
    for emulator in started:
        emulator.stop()
