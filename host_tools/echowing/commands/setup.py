"""`echowing setup`: see that a vehicle is ready for Echowing, and make it so."""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.errors import EchowingError

if TYPE_CHECKING:
    from echowing.setup.apply import Outcome
    from echowing.setup.ftp import Progress
    from echowing.setup.vehicle import Vehicle

EXAMPLES = """\
examples, in the order of a new vehicle:
  echowing setup lua --connect /dev/ttyACM0              the applet, onto the autopilot's SD card
  echowing setup apply --vehicle /dev/ttyACM0 --serial 2 --restart
  echowing setup check --vehicle /dev/ttyACM0 --serial 2
and in the field, over the radio:
  echowing setup check --vehicle udpin:14550@2
`echowing setup PART --help` has more. Exit code of check: 0 fine, 1 wrong, 2 cannot tell.
"""
LUA_EXAMPLES = """\
examples:
  echowing setup lua --connect /dev/ttyACM0              over USB, the card stays in the autopilot
  echowing setup lua --connect udpin:14550@2             over a radio; lost packets are sent again
  echowing setup lua --connect tcp:127.0.0.1:5760 --folder scripts     ArduPilot's SITL
  echowing setup lua --mount /media/$USER/PIXHAWK        the card in this computer
"""
CHECK_EXAMPLES = """\
examples:
  echowing setup check --vehicle /dev/ttyACM0            over USB
  echowing setup check --vehicle udpin:14550@2 --serial 2      co-processor on SERIAL2 (TELEM2)
  echowing setup check --vehicle tcp:192.168.4.1:5760 --json | jq '.findings[]'
exit code: 0 all is fine, 1 something is wrong, 2 something cannot be told
"""
APPLY_EXAMPLES = """\
examples:
  echowing setup apply --vehicle /dev/ttyACM0 --serial 2       shows the changes and asks
  echowing setup apply --vehicle /dev/ttyACM0 --serial 2 --yes --restart
  echowing setup restore echowing-2-20261121-093000.params.json --vehicle /dev/ttyACM0
Fail-safes and fence are never written, only reported: they are the pilot's.
"""
RESTORE_EXAMPLES = """\
example:
  echowing setup restore echowing-2-20261121-093000.params.json --vehicle /dev/ttyACM0
"""
SERIAL_PORTS = range(1, 10)
RANGEFINDERS = range(1, 10)
INTERRUPTED_EXIT = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True)
    _add_check(_part(parts, "check", "is the vehicle ready? what is wrong, and how to fix it"))
    _add_apply(_part(parts, "apply", "write what is wrong, the old values kept in a file"))
    _add_restore(_part(parts, "restore", "put back the values that apply has kept"))
    _add_lua(_part(parts, "lua", "the applet, onto the autopilot's SD card"))


def _part(parts: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, text: str):  # type: ignore[no-untyped-def]
    return parts.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _add_vehicle(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--vehicle",
        required=True,
        metavar="CONN[@ID]",
        help="udpin:[HOST:]PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:[HOST:]PORT or a serial "
        "device; @ID where several vehicles share the link",
    )
    _add_link(parser)


def _add_link(parser: argparse.ArgumentParser) -> None:
    from echowing.links import DEFAULT_BAUD  # noqa: PLC0415 (imported when the verb is used)

    parser.add_argument("--baud", type=int, default=DEFAULT_BAUD, help="of a serial device")
    parser.add_argument(
        "--signing-key-file", type=Path, metavar="FILE", help="as for `echowing follow`"
    )


def _add_wiring(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--serial",
        type=int,
        choices=SERIAL_PORTS,
        metavar="N",
        help="the co-processor is wired to the autopilot's SERIALn (2: TELEM2)",
    )
    parser.add_argument(
        "--rangefinder",
        type=int,
        choices=RANGEFINDERS,
        default=1,
        metavar="N",
        help="use RNGFNDn, where another sensor has the first (1)",
    )


def _add_check(parser: argparse.ArgumentParser) -> None:
    parser.epilog = CHECK_EXAMPLES
    _add_vehicle(parser)
    _add_wiring(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _add_apply(parser: argparse.ArgumentParser) -> None:
    parser.epilog = APPLY_EXAMPLES
    _add_vehicle(parser)
    _add_wiring(parser)
    parser.add_argument("--yes", action="store_true", help="write without asking")
    parser.add_argument("--restart", action="store_true", help="restart the autopilot afterwards")
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE",
        help="for the old values (echowing-ID-DATE.params.json)",
    )


def _add_restore(parser: argparse.ArgumentParser) -> None:
    parser.epilog = RESTORE_EXAMPLES
    parser.add_argument("file", type=Path, metavar="FILE", help="what apply has written")
    _add_vehicle(parser)
    parser.add_argument("--restart", action="store_true", help="restart the autopilot afterwards")


def _add_lua(parser: argparse.ArgumentParser) -> None:
    parser.epilog = LUA_EXAMPLES
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument("--connect", metavar="CONN[@ID]", help="over MAVLink (MAVFTP), disarmed")
    way.add_argument(
        "--mount", type=Path, metavar="DIR", help="where the autopilot's SD card is mounted"
    )
    parser.add_argument(
        "--folder",
        default="APM/scripts",
        help="with --connect: the scripts' folder on the vehicle (APM/scripts; scripts in SITL)",
    )
    _add_link(parser)


def run(args: argparse.Namespace) -> int:
    """Do the part that was asked for."""
    parts = {"check": _check, "apply": _apply, "restore": _restore, "lua": _lua}
    return parts[args.part](args)


def _tell(text: str) -> None:
    """Not on stdout, which may be JSON."""
    print(text, file=sys.stderr)


@contextmanager
def _vehicle(where: str, args: argparse.Namespace) -> "Iterator[Vehicle]":
    from echowing.setup.vehicle import open_vehicle  # noqa: PLC0415

    key = args.signing_key_file
    with open_vehicle(where, baud=args.baud, signing_key_file=key, say=_tell) as vehicle:
        yield vehicle


# ---- check -------------------------------------------------------------------------------------


def _check(args: argparse.Namespace) -> int:
    from echowing.setup.checks import examine, exit_code  # noqa: PLC0415
    from echowing.setup.reading import read_out  # noqa: PLC0415
    from echowing.setup.view import as_json, as_lines  # noqa: PLC0415

    with _vehicle(args.vehicle, args) as vehicle:
        _tell(f"{vehicle.name}: listening and reading parameters …")
        readout = read_out(vehicle, args.serial, args.rangefinder)
        findings = examine(readout)
        system_id = vehicle.system_id
    if args.json:
        print(json.dumps(as_json(system_id, readout, findings), indent=2))
    else:
        print("\n".join(as_lines(system_id, readout, findings)))
    return exit_code(findings)


# ---- apply and restore -------------------------------------------------------------------------


def _apply(args: argparse.Namespace) -> int:
    from datetime import datetime  # noqa: PLC0415

    from echowing.setup.apply import changes_for, default_file, save  # noqa: PLC0415
    from echowing.setup.reading import read_parameters  # noqa: PLC0415
    from echowing.setup.readout import Readout  # noqa: PLC0415
    from echowing.setup.view import differences  # noqa: PLC0415

    with _vehicle(args.vehicle, args) as vehicle:
        vehicle.refuse_armed("parameters are written")
        _tell(f"{vehicle.name}: reading parameters …")
        parameters = read_parameters(vehicle, args.serial, args.rangefinder)
        readout = Readout(parameters, serial_port=args.serial, rangefinder=args.rangefinder)
        changes = changes_for(readout)
        for line in differences(readout, changes):
            print(line)
        if not changes:
            print("nothing to write")
            return 0
        if not args.yes and not _agreed():
            print("nothing was changed")
            return 1
        vehicle.look_again()  # the operator may have thought about it for a while
        vehicle.refuse_armed("parameters are written")
        now = datetime.now()
        file = args.save or default_file(vehicle.system_id, now)
        save(file, vehicle.system_id, changes, now)
        print(f"old values: {file}", flush=True)
        values = [(change.name, change.new) for change in changes]
        back = f"back: echowing setup restore {file} --vehicle {args.vehicle}"
        outcome = _write(vehicle, values, back)
        if outcome is None:
            return INTERRUPTED_EXIT
        print(back)
        _finish(vehicle, [c.name for c in changes if c.restart], args)
    return 1 if outcome.refused else 0


def _agreed() -> bool:
    if not sys.stdin.isatty():
        raise EchowingError("nobody is there to ask; give --yes to write without asking")
    return input("Write these? [y/N] ").strip().lower() in ("y", "yes")


def _write(
    vehicle: "Vehicle", values: Sequence[tuple[str, float]], way_back: str
) -> "Outcome | None":
    """Write, and whatever ends it in the middle, say how to go back. None: interrupted."""
    from echowing.setup.apply import write_all  # noqa: PLC0415

    def write(name: str, value: float) -> float:
        vehicle.refuse_armed("parameters are written")
        return vehicle.write(name, value)

    try:
        outcome = write_all(values, write, _written(len(values)))
    except EchowingError as error:
        raise EchowingError(f"{error}\nonly some values are written; {way_back}") from error
    except KeyboardInterrupt:
        _tell(f"interrupted; only some values are written; {way_back}")
        return None
    for name, now in outcome.refused.items():
        wanted = dict(values)[name]
        print(f"{name} is {now:g} after writing {wanted:g}: the autopilot will not have it")
    print(f"{len(outcome.written)} of {len(values)} written and read back")
    return outcome


def _written(total: int) -> Callable[[str], None]:
    count = 0

    def progress(name: str) -> None:
        nonlocal count
        count += 1
        print(f"writing {count} of {total}: {name}", flush=True)

    return progress


def _finish(vehicle: "Vehicle", restart: Sequence[str], args: argparse.Namespace) -> None:
    """Restart the autopilot, or say that it has to be."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: PLC0415

    if not restart:
        return
    if not args.restart:
        print(f"restart the autopilot: {', '.join(restart)} count only then")
        return
    result = vehicle.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    done = result == mavlink.MAV_RESULT_ACCEPTED
    print("the autopilot restarts" if done else "it does not restart by command: take its power")


def _restore(args: argparse.Namespace) -> int:
    from echowing.setup.apply import load  # noqa: PLC0415

    saved = load(args.file)
    with _vehicle(args.vehicle, args) as vehicle:
        if vehicle.system_id != saved.system_id:
            raise EchowingError(
                f"{args.file} is of vehicle {saved.system_id}, and this is {vehicle.name}; "
                "nothing was changed"
            )
        vehicle.refuse_armed("parameters are written")
        # In reverse: a sensor's TYPE goes last, as its other parameters may hide with it.
        values = list(saved.parameters.items())[::-1]
        again = f"once more: echowing setup restore {args.file} --vehicle {args.vehicle}"
        outcome = _write(vehicle, values, again)
        if outcome is None:
            return INTERRUPTED_EXIT
        _finish(vehicle, list(saved.parameters), args)
    return 1 if outcome.refused else 0


# ---- lua ---------------------------------------------------------------------------------------


def _lua(args: argparse.Namespace) -> int:
    return _lua_on_card(args.mount) if args.connect is None else _lua_over_link(args)


def _lua_on_card(mount: Path) -> int:
    """Copy, verify, and say what is left to do."""
    from echowing.applet import applet_path, checksum, install_on_card  # noqa: PLC0415

    target = install_on_card(mount)
    print(f"{target}: written and verified, checksum {checksum(applet_path().read_bytes()):08x}")
    print("Unmount the card; on the vehicle set SCR_ENABLE 1, restart, then ECHO_ENABLE 1.")
    return 0


def _lua_over_link(args: argparse.Namespace) -> int:
    from echowing.applet import applet_path, install_over_link  # noqa: PLC0415
    from echowing.ftp_format import ardupilot_crc32  # noqa: PLC0415
    from echowing.setup.ftp import FtpClient  # noqa: PLC0415

    with _vehicle(args.connect, args) as vehicle:
        vehicle.refuse_armed("scripts are replaced")
        folder = args.folder.strip("/")
        with _progress_bar() as bar:
            written = install_over_link(FtpClient(vehicle), bar, folder)
        crc = ardupilot_crc32(applet_path().read_bytes())
        state = "written, read back" if written else "the same applet was there already"
        print(f"{folder}/echowing.lua: {state}, ArduPilot's CRC-32 {crc:08x}")
        print(_restart_scripts(vehicle))
    return 0


@contextmanager
def _progress_bar() -> "Iterator[Callable[[str], Progress]]":
    """A bar for each step; lines where nobody watches."""
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:

        def step(title: str) -> Callable[[int, int], None]:
            task = bars.add_task(title, total=None)
            return lambda done, total: bars.update(task, completed=done, total=total)

        yield step


READY_TEXT, READY_TIMEOUT_S = "ECHO: ready", 10.0


def _restart_scripts(vehicle: "Vehicle") -> str:
    """Have the autopilot load its scripts anew; says what came of it."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: PLC0415

    if vehicle.read(["SCR_ENABLE"]).get("SCR_ENABLE") != 1.0:
        return "scripting is off: param set SCR_ENABLE 1 (or echowing setup apply), then restart"
    if vehicle.armed:
        return "it has been armed meanwhile: restart the autopilot when it is disarmed"
    vehicle.texts.clear()
    result = vehicle.command_int(mavlink.MAV_CMD_SCRIPTING, mavlink.SCRIPTING_CMD_STOP_AND_RESTART)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        return "restart the autopilot: it does not restart its scripts by command"
    until_s = vehicle.now_s() + READY_TIMEOUT_S
    while vehicle.now_s() < until_s:
        vehicle.poll()
        if READY_TEXT in vehicle.texts:
            return "the applet runs; next: echowing setup apply, then echowing setup check"
    heard = "; ".join(vehicle.texts) or "nothing"
    return f"the applet has not said that it is ready; restart the autopilot (it said: {heard})"
