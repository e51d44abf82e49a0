"""The memory that an applet needs on an autopilot, by running it on a 32-bit processor.

    .venv/bin/python -m tests.lua.heap [APPLET …]

The applet flies on a vehicle on the desk; what the bindings answer is recorded. The same Lua as the
autopilot's (5.3.6, 32-bit numbers and pointers, ArduPilot's limits) then runs the applet with these
answers on QEMU's Cortex-M4, in a heap that works as ChibiOS' does, with a full collection after
each update as ArduPilot makes one: see board/. The applet is loaded in ever smaller heaps until it
no longer loads or flies.

ArduCopter 4.6 takes 6 kB more of the same memory than 4.7 and 4.8: it makes the classes of all
bindings when it starts, not those that a script uses, and has a library more (utf8). 4.5 takes
16 kB more again: it makes all singletons, too, and gives all of them to each script.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from tests.lua.conftest import NEW, Rig

from echowing.paths import lua_folder
from echowing.sim.vehicle.desk import GOOD
from echowing.sim.vehicle.luahost import BINDINGS as ANNOTATIONS
from echowing.sim.vehicle.luahost import LuaHost, read_bindings
from echowing.sim.vehicle.rangefinder import MAVLINK_TYPE, MAXBOTIX_TYPE

ROOT = Path(__file__).resolve().parents[2]
SOURCES = Path(__file__).with_name("board")
LUA = ROOT / "build/tools/lua53"  # host_tools/setup.sh puts it there
BUILD = ROOT / "build/applet-heap"
ELF = BUILD / "scripting.elf"

# What ArduPilot changes in Lua's source that counts for memory: libraries/AP_Scripting/lua/src. And
# the seed of its hashes, which on a vehicle comes from addresses: of the measure's choice here.
CHANGES = {
    "lparser.c": (r"#define MAXVARS\s+200\b", "#define MAXVARS 100"),
    "lfunc.h": (r"#define MAXUPVAL\s+255\b", "#define MAXUPVAL 127"),
    "lstate.c": (r"g->seed = makeseed\(L\);", "extern unsigned hash_seed; g->seed = hash_seed;"),
    "lstrlib.c": (r"\n  createmetatable\(L\);", "\n  (void)createmetatable;"),
    "luaconf.h": (
        r"#define LUAL_BUFFERSIZE\s+\(\(int\)\(0x80 ",
        "#define LUAL_BUFFERSIZE ((int)(0x20 ",
    ),
}
FIRMWARES = NEWEST, MIDDLE, OLDEST = "4.8", "4.6", "4.5"  # ArduCopter
TOO_FAR, GUIDED, LOITER = 3, 4, 5  # RangeFinder::Status; Copter's modes
FARTHEST_M = 7.65  # the sonar's
WRITTEN = {"ECHO_MIRROR", "ECHO_FORMAT"}  # by the applets themselves
NO_VALUE = -1.0  # below the range of every parameter of theirs
NOT_BUILT = {"lua.c", "luac.c", "ltests.c", "lbaselib.c"}  # the last is part of scripting.c
CC = "arm-none-eabi-gcc -std=gnu11 -Os -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard"
QEMU = "qemu-system-arm -M mps2-an386 -display none -serial null -monitor none -icount shift=0"


@dataclass(frozen=True)
class Need:
    """What an applet needs on the autopilot."""

    trouble: str | None
    """Why it did not fly in the heap that was tried; None: it did."""
    words: int
    """Different names, texts and numbers, Lua's own words among them. The compiler has a table of
    them: with 257 it takes 10 kB, with 513 twice as much."""
    least_bytes: int
    """It loads and flies in each heap from so much on."""
    live_bytes: int
    """Most in use after the collection that follows an update."""
    load_peak_bytes: int
    """Most in use while it loads, where there is plenty."""
    peak_bytes: int
    told_bytes: int
    """What the vehicle tells of it after an update with `SCR_DEBUG_OPTS` 2: without the headers of
    blocks, and with what the update leaves."""
    garbage_bytes: int
    """Most that an update leaves for the collection."""
    updates: int
    update_instructions: int
    """Of the processor, the longest update in flight; counted in steps of 40."""
    collect_instructions: int
    """The same of the collection after it."""


class RecordingHost(LuaHost):
    """Writes down what each binding answers."""

    note_update: Callable[[], None]
    write: Callable[[str], None]

    def _load(self, script: Path) -> Any:
        sandbox = self._host.load("return _ENV", "=sandbox")()
        recorder = (SOURCES / "recorder.lua").read_text(encoding="utf-8")
        bindings = read_bindings(ANNOTATIONS.read_text(encoding="utf-8"))
        functions = self._lua.table_from({b.name: True for b in bindings if not b.owner})
        self.note_update, self.write = self._lua.execute(recorder, sandbox, functions)
        return super()._load(script)

    def _run(self, t_ms: int) -> None:
        super()._run(t_ms)
        self.note_update()


class RecordedRig(Rig):
    """The applet on a vehicle on the desk, recorded."""

    def new_host(self) -> RecordingHost:
        plenty = 1 << 28  # of instructions and memory: the recorder takes some
        return RecordingHost(
            self.vehicle,
            self.script,
            generation=self.names.generation,
            instruction_limit=plenty,
            heap_bytes=plenty,
        )


def record_flight(applet: Path, file: Path) -> None:
    """Fly through all that an applet does, on points with a velocity and without; write it."""
    rig = RecordedRig(NEW, applet)
    vehicle = rig.vehicle
    vehicle.is_armed = False
    rig.run(1.5)
    vehicle.is_armed = True
    vehicle.velocity = (2.0, 0.3, 0.0)
    for velocity_mps in (2.0, None):
        _fly(rig, 3.0, lambda t: 3.0 + 0.6 * math.sin(t), velocity_mps)
        _fly(rig, 2.0, lambda t: max(0.4, 3.0 - 1.5 * t), velocity_mps)  # the leader comes back
        rig.run(1.0)  # the ground tool is lost, the leader is heard
        _fly(rig, 2.0, lambda t: 3.0 if t < 0.5 else 8.0, velocity_mps)  # it is lost
        rig.run(2.0)  # both are
        _fly(rig, 1.0, lambda t: 3.2, velocity_mps)
        rig.no_data().run(1.5)
        vehicle.range_type = MAXBOTIX_TYPE  # the autopilot's own driver reads one
        _fly(rig, 2.0, lambda t: 3.0 if t < 1.0 else 8.0, velocity_mps)
        vehicle.range_type = MAVLINK_TYPE
        vehicle.mode = LOITER
        rig.run(0.5)
        vehicle.mode = GUIDED
    vehicle.parameters |= dict.fromkeys(sorted(vehicle.added - WRITTEN), NO_VALUE)
    rig.run(5.0)  # each is read, and told
    vehicle.is_armed = False
    rig.run(1.0)
    _write(rig, file)


def record_start(applet: Path, file: Path) -> None:
    """Record its first second: what does the same in each update needs no more in a flight."""
    rig = RecordedRig(NEW, applet)
    rig.run(1.0)
    _write(rig, file)


def _write(rig: RecordedRig, file: Path) -> None:
    assert isinstance(rig.host, RecordingHost)
    rig.host.write(str(file))


def _fly(
    rig: Rig, seconds: float, range_m: Callable[[float], float], velocity_mps: float | None
) -> None:
    """A stretch with guided points, and with the ranges of its own time."""
    vehicle, start_ms = rig.vehicle, rig.vehicle.t_ms
    rig.raw_every_ms = 100
    while vehicle.t_ms < start_ms + round(seconds * 1000):
        metres = range_m((vehicle.t_ms - start_ms) / 1000.0)
        rig.range(metres, GOOD if metres < FARTHEST_M else TOO_FAR)
        if vehicle.t_ms % 120 == 0:
            rig.send_target(5.0, velocity_mps, aside_m=0.5, aside_mps=0.1, yaw_rad=0.1)
        rig.step()


def build() -> Path:
    """The engine for the Cortex-M4; nothing is done where it is up to date."""
    if not (LUA / "lua.h").exists():
        raise SystemExit("heap: Lua's source is missing; run `make setup-test`")
    sources = [*SOURCES.glob("*.[ch]"), SOURCES / "mps2.ld", Path(__file__)]
    newest = max(file.stat().st_mtime for file in sources)
    if ELF.exists() and ELF.stat().st_mtime > newest:
        return ELF
    shutil.rmtree(BUILD, ignore_errors=True)
    shutil.copytree(LUA, BUILD / "lua")
    for name, (old, new) in CHANGES.items():
        file = BUILD / "lua" / name
        text, count = re.subn(old, new, file.read_text(encoding="utf-8"))
        if count != 1:
            raise SystemExit(f"heap: {file} is not the Lua 5.3 that ArduPilot carries")
        file.write_text(text, encoding="utf-8")
    lua = [str(f) for f in (BUILD / "lua").glob("*.c") if f.name not in NOT_BUILT]
    own = [str(f) for f in SOURCES.glob("*.c")]
    flags = ["-DLUA_32BITS", f"-I{BUILD / 'lua'}", "-T", str(SOURCES / "mps2.ld")]
    flags += [
        "--specs=nosys.specs",
        "-nostartfiles",
        "-Wl,--gc-sections",
        "-ffunction-sections",
        "-lm",
    ]
    half_done = ELF.with_suffix(".part")
    _run([*CC.split(), *own, *lua, *flags, "-o", str(half_done)], timeout_s=300)
    half_done.rename(ELF)
    return ELF


def _run(command: list[str], timeout_s: float) -> None:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        raise SystemExit(f"heap: {command[0]} takes more than {timeout_s:.0f} s") from None
    if done.returncode:
        raise SystemExit(f"heap: {command[0]} failed: {done.stderr or done.stdout}")


def need(applet: Path, heap_bytes: int = 0, firmware: str = NEWEST) -> Need:
    """What an applet needs; with `heap_bytes`: whether it loads and flies in so much."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder, "record")
        record_flight(applet, record)
        return fly_recorded(applet, record, heap_bytes, firmware)


def fly_recorded(applet: Path, record: Path, heap_bytes: int = 0, firmware: str = NEWEST) -> Need:
    """Run an applet on the 32-bit processor, with the answers of a recorded flight."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "result")
        given = ["scripting", str(applet), str(record), str(result), str(heap_bytes), firmware]
        arguments = ",".join(f"arg={text}" for text in given)
        semihosting = f"enable=on,target=native,{arguments}"
        command = [*QEMU.split(), "-semihosting-config", semihosting, "-kernel", str(build())]
        _run(command, timeout_s=300)
        return Need(**json.loads(result.read_text(encoding="utf-8")))


def main() -> None:
    """Print one line an applet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("applet", nargs="*", type=Path, default=sorted(lua_folder().glob("*.lua")))
    print(
        f"{'':24}{'least heap':>11}{'in flight':>11}{'loading':>11}{'told':>11}{'words':>7}  "
        "update + collection"
    )
    for applet, firmware in product(parser.parse_args().applet, FIRMWARES):
        found = need(applet, firmware=firmware)
        if found.trouble is not None:
            raise SystemExit(f"heap: {applet}: {found.trouble}")
        print(
            f"{applet.name + ' ' + firmware:24}{found.least_bytes:11,}{found.live_bytes:11,}"
            f"{found.load_peak_bytes:11,}{found.told_bytes:11,}{found.words:7}  "
            f"{found.update_instructions:,} + {found.collect_instructions:,} instructions"
        )


if __name__ == "__main__":
    main()
