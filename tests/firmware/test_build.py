"""Building and flashing: what is printed, what is refused, and that the bytes arrive."""

import dataclasses
import importlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import make_release
from echowing import __version__
from echowing.errors import EchowingError
from echowing.sim.boards import firmware

from .fake_programmer import FakeProgrammer
from .fake_rom_loader import FLASH_START, PAGE, FakeRomLoader

pytestmark = pytest.mark.seconds(12)

TOOLS = firmware.REPOSITORY / "firmware" / "tools"
Run = Callable[..., subprocess.CompletedProcess[str]]


def run(*command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command at the root of the checkout."""
    return subprocess.run(
        command,
        cwd=firmware.REPOSITORY,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


class TestSizes:
    def test_are_those_of_binutils(self, mega_elf: Path) -> None:
        table = run("avr-size", "-A", mega_elf).stdout
        rows = re.findall(r"^(\.\S+)\s+(\d+)", table, re.MULTILINE)
        sections = {name: int(length) for name, length in rows}
        used = firmware.size(mega_elf, "mega")
        assert used.flash == sections[".text"] + sections[".data"]
        assert used.ram == sections[".data"] + sections[".bss"] + sections.get(".noinit", 0)

    def test_firmware_keeps_its_limits(self, mega_elf: Path) -> None:
        used = firmware.size(mega_elf, "mega")
        assert 10_000 < used.flash < 44 * 1024
        assert 500 < used.ram < 4 * 1024

    def test_broken_limit_is_shouted_and_fails(
        self, mega_elf: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        tight = dataclasses.replace(firmware.BOARDS["mega"], flash_limit=9_999)
        monkeypatch.setitem(firmware.BOARDS, "mega", tight)
        assert firmware.main(["mega"]) == 1
        flash, ram = capsys.readouterr().out.splitlines()
        assert flash.endswith("limit 9999: TOO BIG")
        assert ram.endswith("limit 4096: ok")

    def test_truncated_binary_is_told(self, mega_elf: Path, tmp_path: Path) -> None:
        short = tmp_path / "short.elf"
        short.write_bytes(mega_elf.read_bytes()[:5000])
        with pytest.raises(EchowingError, match="cut short"):
            firmware.size(short, "mega")


class TestMake:
    def test_second_build_does_nothing(self, mega_elf: Path) -> None:
        first = run("make", "-s", "firmware", "BOARD=mega")
        assert first.returncode == 0, first.stderr
        built_ns = mega_elf.stat().st_mtime_ns
        second = run("make", "-s", "firmware", "BOARD=mega")
        assert mega_elf.stat().st_mtime_ns == built_ns
        lines = second.stdout.splitlines()
        assert lines[-2:] == firmware.size_lines(mega_elf, "mega")
        assert len(lines) == 2

    @pytest.mark.parametrize(
        "changed",
        [
            "firmware/echowing/echowing.ino",
            "firmware/echowing/src/core/tracker.cpp",
            "firmware/dialect/echowing.xml",
            "firmware/tools/arduino_home.sh",
        ],
    )
    def test_change_of_a_source_builds_again(self, mega_elf: Path, changed: str) -> None:
        would = run("make", "-n", "-W", changed, "firmware", "BOARD=mega").stdout
        rebuilds = "tools/build.py mega" in would or "arduino_home.sh" in would
        assert rebuilds

    def test_unknown_board_lists_those_there_are(self) -> None:
        failed = run("make", "-s", "firmware", "BOARD=uno")
        assert failed.returncode != 0
        assert "mega, blackpill_f411, bluepill_f103, nucleo_f446" in failed.stderr

    def test_missing_port_lists_those_there_are(self, mega_elf: Path) -> None:
        failed = run("make", "-s", "flash", "BOARD=mega")
        assert failed.returncode != 0
        assert "make flash BOARD=… PORT=…" in failed.stderr
        assert "Ports there now" in failed.stderr


class TestTools:
    def test_stm32_core_out_of_reach_says_what_to_do(self, tmp_path: Path) -> None:
        home = tmp_path / "home"
        assert run(TOOLS / "arduino_home.sh", home).returncode == 0
        nowhere = "http://127.0.0.1:9"  # the discard port: nobody listens
        failed = run(
            sys.executable,
            TOOLS / "build.py",
            "bluepill_f103",
            *("--home", home, "--output", tmp_path / "out"),
            https_proxy=nowhere,
            HTTPS_PROXY=nowhere,
        )
        assert failed.returncode == 2
        assert "needs internet the first time" in failed.stderr
        assert "Traceback" not in failed.stderr

    def test_sketch_that_does_not_compile_shows_the_compiler_s_words(self, tmp_path: Path) -> None:
        sketch = tmp_path / "broken"
        sketch.mkdir()
        (sketch / "broken.ino").write_text("void setup() { nonsense; }\nvoid loop() {}\n")
        failed = run(
            sys.executable,
            TOOLS / "build.py",
            "mega",
            *("--sketch", sketch, "--output", tmp_path / "out"),
        )
        assert failed.returncode == 2
        assert re.search(r"broken\.ino:1.* .nonsense. was not declared", failed.stderr)
        assert "the sketch does not compile for mega" in failed.stderr

    def test_only_the_sketch_s_own_warnings_are_shown(self, tmp_path: Path) -> None:
        sketch = tmp_path / "sloppy"
        sketch.mkdir()
        (sketch / "sloppy.ino").write_text(
            "#include <Wire.h>\nvoid setup() { int unused; Wire.begin(); }\nvoid loop() {}\n"
        )
        built = run(
            sys.executable,
            TOOLS / "build.py",
            "mega",
            *("--sketch", sketch, "--output", tmp_path / "out"),
        )
        assert built.returncode == 0
        assert "unused variable" in built.stderr
        assert "twi.c" not in built.stderr  # Debian's Wire library has warnings of its own

    def test_missing_core_names_the_package(self, tmp_path: Path) -> None:
        failed = run(TOOLS / "arduino_home.sh", tmp_path / "h", ECHOWING_AVR_CORE="/nowhere")
        assert failed.returncode == 1
        assert "apt install arduino-core-avr" in failed.stderr

    @pytest.mark.parametrize(("version", "asks_pypi"), [("go1.19.8", True), ("go1.22.0", False)])
    def test_go_that_is_too_old_is_replaced_by_pypi_s(
        self, tmp_path: Path, version: str, asks_pypi: bool
    ) -> None:
        tree = FakeTree(tmp_path, version)
        built = run(tree.script, tmp_path / "arduino-cli", PATH=f"{tree.path}:/usr/bin:/bin")
        assert built.returncode == 0, built.stderr
        assert (tmp_path / "arduino-cli").read_text() == ("pypi\n" if asks_pypi else "path\n")
        assert tree.pip_log.exists() == asks_pypi


class FakeTree:
    """A checkout with nothing but the script, a Go of some version, and a pip that brings one."""

    def __init__(self, root: Path, version: str) -> None:
        tools, environment, self.path = (
            root / "c" / "firmware" / "tools",
            root / "c" / ".venv" / "bin",
            root / "path",
        )
        for folder in (tools / "arduino-cli", environment, self.path):
            folder.mkdir(parents=True)
        self.script = tools / "arduino_cli.sh"
        self.script.write_text((TOOLS / "arduino_cli.sh").read_text())
        self.script.chmod(0o755)
        self.pip_log = root / "pip.log"
        self._go(self.path / "go", version, "path")
        go = environment / "go"
        self._go(root / "new-go", "go1.27.3", "pypi")
        self._write(
            environment / "python", f'echo "$@" >{self.pip_log}\ncp {root / "new-go"} {go}\n'
        )

    def _go(self, place: Path, version: str, name: str) -> None:
        self._write(
            place,
            f'[ "$1" = version ] && {{ echo "go version {version} linux/amd64"; exit; }}\n'
            f'echo {name} >"$4"\n',
        )

    @staticmethod
    def _write(place: Path, body: str) -> None:
        place.write_text(f"#!/bin/sh\n{body}")
        place.chmod(0o755)


@pytest.fixture
def flash(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """firmware/tools/flash.py."""
    monkeypatch.syspath_prepend(str(TOOLS))
    return importlib.import_module("flash")


class TestFlash:
    def test_every_byte_arrives(self, mega_elf: Path, programmer: FakeProgrammer) -> None:
        flashed = run("make", "-s", "flash", "BOARD=mega", f"PORT={programmer.port}")
        assert flashed.returncode == 0, flashed.stderr
        image = mega_elf.with_suffix(".bin")
        run("avr-objcopy", "-O", "binary", "-R", ".eeprom", mega_elf, image)
        wanted = image.read_bytes()
        assert programmer.image()[: len(wanted)] == wanted
        assert set(programmer.image()[len(wanted) :]) <= {0xFF}  # the last page's rest
        assert programmer.left

    def test_every_byte_of_a_release_arrives(
        self, mega_elf: Path, programmer: FakeProgrammer, tmp_path: Path
    ) -> None:
        """And none of an image that is another one than the release's."""
        folder = release_of("mega", mega_elf.with_suffix(".hex"), tmp_path)
        order = ("make", "-s", "flash", "BOARD=mega", f"PORT={programmer.port}")
        flashed = run(*order, f"RELEASE={folder}")
        assert flashed.returncode == 0, flashed.stderr
        assert len(programmer.image()) > 40_000
        assert programmer.left
        programmer.flash.clear()
        (folder / "echowing-mega.hex").write_text(":00000001FF\n")
        refused = run(*order, f"RELEASE={folder}")
        assert refused.returncode != 0 and "its checksum differs" in refused.stderr
        assert programmer.flash == {}

    def test_another_chip_is_refused(
        self, mega_elf: Path, flash: ModuleType, programmer: FakeProgrammer
    ) -> None:
        programmer.signature = bytes([0x1E, 0x95, 0x0F])  # an Uno's ATmega328P
        with pytest.raises(EchowingError, match="was not flashed"):
            flash.flash("mega", programmer.port)
        assert programmer.flash == {}

    def test_port_that_is_not_there(self, mega_elf: Path, flash: ModuleType) -> None:
        with pytest.raises(EchowingError, match="no port /dev/ttyNONE: is the board plugged in"):
            flash.flash("mega", "/dev/ttyNONE")

    def test_port_that_is_no_port(self, mega_elf: Path, flash: ModuleType) -> None:
        with pytest.raises(EchowingError, match="is not a serial port"):
            flash.flash("mega", str(mega_elf))

    def test_port_without_permission(
        self,
        mega_elf: Path,
        flash: ModuleType,
        programmer: FakeProgrammer,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(os, "access", lambda *_: False)  # root may do anything
        with pytest.raises(EchowingError, match=r"sudo usermod -aG \w+ \$USER"):
            flash.flash("mega", programmer.port)

    def test_missing_avrdude(
        self,
        mega_elf: Path,
        flash: ModuleType,
        programmer: FakeProgrammer,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setenv("PATH", "/nowhere")
        with pytest.raises(EchowingError, match="apt install avrdude"):
            flash.flash("mega", programmer.port)

    def test_method_that_the_board_has_not(self, mega_elf: Path, flash: ModuleType) -> None:
        with pytest.raises(EchowingError, match="a mega is not flashed by 'dfu': METHOD is one of"):
            flash.flash("mega", None, "dfu")

    def test_nothing_built_yet(
        self, flash: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(firmware, "REPOSITORY", tmp_path)
        with pytest.raises(EchowingError, match="make firmware BOARD=mega"):
            flash.flash("mega", "/dev/null")


def release_of(board: str, image: Path, folder: Path) -> Path:
    """A release with nothing but a wheel's name and one board's firmware."""
    release = folder / "release"
    release.mkdir()
    (release / f"echowing-{__version__}-py3-none-any.whl").touch()
    shutil.copyfile(image, release / f"echowing-{board}{image.suffix}")
    make_release.write_sums(release)
    return release


IMAGE = bytes(range(256)) * 21 + b"not a whole page"


@pytest.fixture
def stm32_image(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A built firmware for each STM32 board, and a PATH with nothing else than what a test adds."""
    header = bytearray(52)
    header[:4] = b"\x7fELF"
    header[18] = firmware.ELF_MACHINE_ARM
    monkeypatch.setattr(firmware, "REPOSITORY", tmp_path)
    for board in firmware.BOARDS.values():
        elf = firmware.elf_path(board.name)
        elf.parent.mkdir(parents=True)
        elf.write_bytes(header)
        elf.with_suffix(".bin").write_bytes(IMAGE)
    tools = tmp_path / "tools"
    tools.mkdir()
    monkeypatch.setenv("PATH", f"{tools}:/usr/bin:/bin")
    return tools


def fake_tool(folder: Path, name: str, says: str, code: int = 0) -> Path:
    """A program that notes its arguments, says something and ends; returns its notes."""
    notes = folder / f"{name}.arguments"
    (folder / f"{name}.says").write_text(says)
    tool = folder / name
    tool.write_text(f'#!/bin/sh\necho "$@" >{notes}\ncat {folder}/{name}.says\nexit {code}\n')
    tool.chmod(0o755)
    return notes


# As dfu-util 0.11 speaks of a chip that has left at once when it was told to.
DFU_UTIL_SAYS = """\
dfu-util: Warning: Invalid DFU suffix signature
dfu-util: A valid DFU suffix will be required in a future dfu-util release
Opening DFU capable USB device...
Download\t[=========================] 100%         5392 bytes
Download done.
File downloaded successfully
Submitting leave request...
dfu-util: Error during download get_status
"""


class TestFlashStm32:
    def test_an_image_of_a_release(
        self, stm32_image: Path, flash: ModuleType, tmp_path: Path
    ) -> None:
        """Nothing is built here: what is flashed is the release's, if its checksum is right."""
        notes = fake_tool(stm32_image, "dfu-util", DFU_UTIL_SAYS)
        elf = firmware.elf_path("blackpill_f411")
        release = release_of("blackpill_f411", elf.with_suffix(".bin"), tmp_path)
        elf.unlink()
        flash.flash("blackpill_f411", None, release=release)
        image = release / "echowing-blackpill_f411.bin"
        assert notes.read_text().endswith(f"-D {image}\n")
        notes.unlink()
        image.write_bytes(b"another")
        with pytest.raises(EchowingError, match="nothing is written"):
            flash.flash("blackpill_f411", None, release=release)
        assert not notes.exists()

    def test_black_pill_by_dfu_needs_no_port(
        self, stm32_image: Path, flash: ModuleType, capfd: pytest.CaptureFixture[str]
    ) -> None:
        notes = fake_tool(stm32_image, "dfu-util", DFU_UTIL_SAYS, code=74)
        flash.flash("blackpill_f411", None)
        image = firmware.elf_path("blackpill_f411").with_suffix(".bin")
        assert notes.read_text() == f"-d 0483:df11 -a 0 -s 0x08000000:leave -D {image}\n"
        said = capfd.readouterr()
        assert "File downloaded successfully" in said.out
        for trouble in ("rror", "arning", "suffix"):
            assert trouble not in said.out + said.err

    def test_dfu_that_fails_shows_why(
        self, stm32_image: Path, flash: ModuleType, capfd: pytest.CaptureFixture[str]
    ) -> None:
        fake_tool(stm32_image, "dfu-util", "dfu-util: Error: No DFU capable USB device\n", code=74)
        with pytest.raises(EchowingError, match="hold BOOT0, press and let go of NRST"):
            flash.flash("blackpill_f411", None)
        assert "No DFU capable USB device" in capfd.readouterr().out

    @pytest.mark.parametrize("board", ["nucleo_f446", "bluepill_f103", "blackpill_f411"])
    def test_st_link(self, stm32_image: Path, flash: ModuleType, board: str) -> None:
        notes = fake_tool(stm32_image, "st-flash", "INFO common.c: Flash written and verified!\n")
        flash.flash(board, None, "stlink")
        image = firmware.elf_path(board).with_suffix(".bin")
        assert notes.read_text() == f"--reset write {image} 0x08000000\n"

    def test_nucleo_s_usual_way_is_its_st_link(self, stm32_image: Path, flash: ModuleType) -> None:
        notes = fake_tool(stm32_image, "st-flash", "")
        flash.flash("nucleo_f446", None)
        assert notes.exists()

    def test_st_link_that_fails(self, stm32_image: Path, flash: ModuleType) -> None:
        fake_tool(stm32_image, "st-flash", "Failed to connect to target\n", code=1)
        with pytest.raises(EchowingError, match="st-info --probe"):
            flash.flash("nucleo_f446", None)

    def test_blue_pill_s_boot_loader_gets_every_byte_and_keeps_the_parameters(
        self, stm32_image: Path, flash: ModuleType, rom_loader: FakeRomLoader
    ) -> None:
        # Debian's stm32flash itself. A pseudo-terminal has no parity bit, the boot loader's has.
        wrapper = stm32_image / "stm32flash"
        wrapper.write_text('#!/bin/sh\nexec /usr/bin/stm32flash -m 8n1 "$@"\n')
        wrapper.chmod(0o755)
        flash.flash("bluepill_f103", rom_loader.port)
        assert rom_loader.flash[: len(IMAGE)] == IMAGE
        pages = -(-len(IMAGE) // PAGE)
        assert rom_loader.erased_pages == list(range(pages))
        assert set(rom_loader.flash[pages * PAGE :]) == {0x5A}
        assert rom_loader.started_at == FLASH_START

    def test_serial_boot_loader_needs_a_port(self, stm32_image: Path, flash: ModuleType) -> None:
        with pytest.raises(EchowingError, match="which port"):
            flash.flash("bluepill_f103", None)

    @pytest.mark.parametrize(
        ("board", "method", "package"),
        [
            ("blackpill_f411", None, "dfu-util"),
            ("bluepill_f103", "stlink", "stlink-tools"),
        ],
    )
    def test_missing_tool_names_the_package(
        self,
        stm32_image: Path,
        flash: ModuleType,
        monkeypatch: pytest.MonkeyPatch,
        board: str,
        method: str | None,
        package: str,
    ) -> None:
        monkeypatch.setenv("PATH", str(stm32_image))
        with pytest.raises(EchowingError, match=f"apt install {package}"):
            flash.flash(board, None, method)

    def test_every_way_of_every_board_is_known(self, flash: ModuleType) -> None:
        for board in firmware.BOARDS.values():
            assert set(board.uploads) <= set(flash.METHODS)


class TestStm32Core:
    """firmware/tools/stm32_home.sh, of whose core there is none here."""

    def core(self, folder: Path, version: str = "2.12.0") -> Path:
        folder.mkdir()
        (folder / "boards.txt").write_text("")
        (folder / "platform.txt").write_text(
            f"version={version}\ncmsis_dir={{runtime.tools.CMSIS-6.2.0.path}}/CMSIS\n"
        )
        return folder

    def cmsis(self, folder: Path) -> Path:
        (folder / "CMSIS" / "Core" / "Include").mkdir(parents=True)
        (folder / "CMSIS" / "Core" / "Include" / "core_cm4.h").write_text("")
        return folder

    def test_without_one_it_says_what_to_install(self, tmp_path: Path) -> None:
        failed = run("make", "-s", "test-stm32", ECHOWING_STM32_CORE="/nowhere", HOME=str(tmp_path))
        assert failed.returncode != 0
        assert "no official STM32 core in /nowhere" in failed.stderr
        assert "arduino-cli core install STMicroelectronics:stm32@2.12.0" in failed.stderr
        assert "ECHOWING_STM32_CORE=/path/to/core" in failed.stderr

    def test_another_version_is_refused(self, tmp_path: Path) -> None:
        core = self.core(tmp_path / "core", "2.11.0")
        failed = run(TOOLS / "stm32_home.sh", tmp_path / "h", ECHOWING_STM32_CORE=str(core))
        assert failed.returncode == 1
        assert "is 2.11.0; sketch.yaml pins 2.12.0" in failed.stderr

    def test_missing_cmsis_is_named(self, tmp_path: Path) -> None:
        core = self.core(tmp_path / "core")
        failed = run(TOOLS / "stm32_home.sh", tmp_path / "h", ECHOWING_STM32_CORE=str(core))
        assert failed.returncode == 1
        assert "no CMSIS 6.2.0" in failed.stderr

    def test_home_leads_to_core_and_compiler(self, tmp_path: Path) -> None:
        laid = run(
            TOOLS / "stm32_home.sh",
            tmp_path / "h",
            ECHOWING_STM32_CORE=str(self.core(tmp_path / "core")),
            ECHOWING_STM32_CMSIS=str(self.cmsis(tmp_path / "cmsis")),
        )
        assert laid.returncode == 0, laid.stderr
        assert "STM32 core 2.12.0" in laid.stdout
        platform = tmp_path / "h" / "user" / "hardware" / "STMicroelectronics" / "stm32"
        assert (platform / "boards.txt").samefile(tmp_path / "core" / "boards.txt")
        local = (platform / "platform.local.txt").read_text()
        assert f"cmsis_dir={tmp_path}/cmsis/CMSIS" in local
        assert "toolchain_dir=/usr\n" in local


def test_clean_keeps_what_was_downloaded(tmp_path: Path) -> None:
    (tmp_path / "Makefile").write_text((firmware.REPOSITORY / "Makefile").read_text())
    kept = ["tools/arduino-cli", "arduino-home/data/packages/core", "arduino-home-stm32/x.yaml"]
    gone = ["firmware/mega/echowing.elf", "host/lib.so", "arduino-home/cache/y"]
    for name in kept + gone:
        (tmp_path / "build" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "build" / name).write_text("")
    assert run("make", "-s", "-C", tmp_path, "clean").returncode == 0
    assert all((tmp_path / "build" / name).exists() for name in kept)
    assert not any((tmp_path / "build" / name).exists() for name in gone)
