"""Building and flashing: what is printed, what is refused, and that the bytes arrive."""

import dataclasses
import importlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from echowing import firmware
from echowing.errors import EchowingError

from .fake_programmer import FakeProgrammer

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
        assert 10_000 < used.flash < 32 * 1024
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

    def test_nothing_built_yet(
        self, flash: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(firmware, "REPOSITORY", tmp_path)
        with pytest.raises(EchowingError, match="make firmware BOARD=mega"):
            flash.flash("mega", "/dev/null")
