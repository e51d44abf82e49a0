"""`echowing emulator`: the board's binary as a process of its own, in real time."""

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.errors import EchowingError

if TYPE_CHECKING:
    from echowing.sim.boards.coprocessor import Coprocessor, SonarBus
    from echowing.sim.world.sonar import TrueSonar

EXAMPLES = """\
examples:
  echowing emulator --board mega --range-cm 350
  echowing emulator --link tcp:127.0.0.1:5773 \\
      --vehicles tcp:127.0.0.1:5762@1 tcp:127.0.0.1:5772@2
      plugged into SERIAL2 of a follower in ArduPilot's SITL; the sonar detects vehicle 1
      where it truly is from vehicle 2 (lua/echowing.md, In SITL)
  echowing emulator --link tcp:127.0.0.1:5773 --target udp:9005
      the same from a program of your own; each datagram
      {"forward_m": 3.5, "right_m": 0.2, "down_m": -0.1} says where the leader is
      in the follower's body frame; a list of these: where all are that may be heard
  echowing emulator --link tcpin:5770 --usb pty --eeprom board.eep
  echowing emulator --board blackpill_f411 --elf build/firmware/blackpill_f411/echowing.elf
"""

# An STM32's processor at a quarter of its pace: one core of a usual machine then keeps up with it.
_SLOWNESS = 4
# No board: `make core`'s library.
_NATIVE = "native"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--board",
        default="mega",
        help="the board to emulate: mega (default), blackpill_f411, bluepill_f103, nucleo_f446; or "
        "native: no board but its core built for this computer, a third of the work",
    )
    parser.add_argument("--elf", type=Path, help="run this binary (build/firmware's)")
    parser.add_argument(
        "--link",
        default="pty",
        metavar="CONN",
        help="the port to the autopilot: tcp:HOST:PORT connects, tcpin:PORT listens, pty (default)",
    )
    parser.add_argument(
        "--usb",
        metavar="CONN",
        help="the USB port, as --link (default: not connected; the Pills have none)",
    )
    seen = parser.add_mutually_exclusive_group()
    seen.add_argument("--range-cm", type=int, metavar="N", help="the sonar always reads N cm")
    seen.add_argument(
        "--target",
        metavar="udp:PORT",
        help="the sonar detects the leader, or several vehicles, where datagrams say",
    )
    seen.add_argument(
        "--vehicles",
        nargs=2,
        metavar=("LEADER", "FOLLOWER"),
        help="the sonar detects the leader where two vehicles in ArduPilot's SITL truly are; a "
        "connection string of each, CONN[@ID]",
    )
    parser.add_argument(
        "--sonar",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="with --target or --vehicles: what the sonar truly is, a key of a scenario's [sonar] "
        "(host_tools/SCENARIOS.md), drawn by the spread of its sonar file; without: one that hears "
        "all within 20 degrees",
    )
    parser.add_argument(
        "--eeprom", type=Path, metavar="FILE", help="keep the board's stored parameters here"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")


def run(args: argparse.Namespace) -> int:
    """Run until stopped."""
    from echowing.sim.boards.coprocessor import AUTOPILOT_PORT, USB_PORT  # noqa: PLC0415
    from echowing.sim.boards.desk import Desk, Scene  # noqa: PLC0415
    from echowing.sim.boards.sitl_scene import SitlScene  # noqa: PLC0415
    from echowing.sim.boards.wires import open_wire  # noqa: PLC0415

    if args.elf is not None and not args.elf.is_file():
        raise EchowingError(f"--elf {args.elf}: no such file")
    with contextlib.ExitStack() as stack:
        watched = None
        if args.vehicles is not None:
            sitl = SitlScene(*args.vehicles, say=lambda text: print(text, flush=True))
            stack.callback(sitl.close)
            watched = sitl.leader_body_m
        scene = Scene(args.range_cm, args.target, watched, _sonar(args.sonar))
        stack.callback(scene.close)
        board = _board(args, scene.sensor, stack)
        wires = {AUTOPILOT_PORT: open_wire(args.link)}
        stack.callback(wires[AUTOPILOT_PORT].close)
        print(f"autopilot port: {wires[AUTOPILOT_PORT].describe()}", flush=True)
        if args.usb:
            wires[USB_PORT] = open_wire(args.usb)
            stack.callback(wires[USB_PORT].close)
            print(f"USB port: {wires[USB_PORT].describe()}", flush=True)
        if scene.udp_port is not None:
            print(f"target datagrams: udp 127.0.0.1:{scene.udp_port}", flush=True)
        Desk(board, wires, scene).run(args.duration)
    return 0


def _board(
    args: argparse.Namespace, sonar: "SonarBus", stack: contextlib.ExitStack
) -> "Coprocessor":
    """What runs; what it stored is kept when `stack` ends."""
    from echowing.sim.boards.by_name import emulated_board  # noqa: PLC0415
    from echowing.sim.boards.coprocessor import USB_PORT, NativeCoprocessor  # noqa: PLC0415

    if args.board == _NATIVE:
        if args.elf is not None or args.eeprom is not None:
            raise EchowingError(
                f"--board {_NATIVE} is the core built for this computer: it runs no --elf and "
                "stores nothing in an --eeprom; leave them out"
            )
        return NativeCoprocessor(sonar)
    board = emulated_board(
        sonar, board=args.board, elf=args.elf, eeprom=_load(args.eeprom), slowness=_SLOWNESS
    )
    if args.usb and not board.has_port(USB_PORT):
        raise EchowingError(
            f"the emulated {args.board} has no USB port (nothing is plugged into its socket): "
            "leave --usb out"
        )
    if args.eeprom:
        stack.callback(lambda: _save(args.eeprom, board.eeprom()))
    return board


def _sonar(changes: list[str]) -> "TrueSonar":
    """The sonar that a scenario with these keys would give its first follower."""
    from echowing.sim.hangar import Hangar  # noqa: PLC0415
    from echowing.sim.scenario import load_scenario  # noqa: PLC0415
    from echowing.sim.world.sonar import ON_A_DESK  # noqa: PLC0415

    if not changes:
        return ON_A_DESK
    scenario = load_scenario("echowing", [f"sonar.{change}" for change in changes])
    return Hangar(scenario, seed=1).ear(0).sonar


def _load(path: Path | None) -> bytes | None:
    try:
        return path.read_bytes() if path and path.exists() else None
    except OSError as error:
        raise EchowingError(f"cannot read the memory from {path}: {error.strerror}") from error


def _save(path: Path, image: bytes) -> None:
    try:
        path.write_bytes(image)
    except OSError as error:
        raise EchowingError(f"cannot keep the memory in {path}: {error.strerror}") from error
