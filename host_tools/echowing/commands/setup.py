"""`echowing setup`: check whether a vehicle is ready for Echowing, and make it ready."""

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.errors import EchowingError
from echowing.paths import SHIPPED_SONAR

if TYPE_CHECKING:
    from echowing.applets import Applet
    from echowing.setup.ftp import Progress
    from echowing.setup.job import Work
    from echowing.setup.vehicle import Vehicle

EXAMPLES = """\
examples, in the order of a new vehicle:
  echowing setup lua --vehicle /dev/ttyACM0              copies the applet to its SD card
  echowing setup apply --vehicle /dev/ttyACM0 --serial 2 --restart
  echowing setup check --vehicle /dev/ttyACM0 --serial 2
and in the field, over the radio:
  echowing setup check --vehicle udpin:14550@2
  echowing setup check --vehicle udpin:14550@1 --role leader
`echowing setup PART --help` has more. Exit code of check: 0 fine, 1 wrong, 2 not checked.
"""
LUA_EXAMPLES = """\
examples:
  echowing setup lua --vehicle /dev/ttyACM0              over USB, the card stays in the autopilot
  echowing setup lua --vehicle udpin:14550@2             over a radio; lost packets are sent again
  echowing setup lua --vehicle tcp:127.0.0.1:5760 --folder scripts     ArduPilot's SITL
  echowing setup lua --mount /media/$USER/PIXHAWK        the card in this computer
  echowing setup lua --vehicle /dev/ttyACM0 --release dist/0.2.0      from a release
"""
CHECK_EXAMPLES = """\
examples:
  echowing setup check --vehicle /dev/ttyACM0            over USB
  echowing setup check --vehicle udpin:14550@2 --serial 2      co-processor on SERIAL2 (TELEM2)
  echowing setup check --vehicle tcp:192.168.4.1:5760 --json | jq '.findings[]'
Exit code: 0 all is fine, 1 something is wrong, 2 something could not be checked.
"""
APPLY_EXAMPLES = """\
examples:
  echowing setup apply --vehicle /dev/ttyACM0 --serial 2       shows the changes and asks
  echowing setup apply --vehicle /dev/ttyACM0 --serial 2 --yes --restart
  echowing setup restore echowing-2-20261121-093000.params.json --vehicle /dev/ttyACM0
Fail-safes and fence are reported, never written: they are the pilot's to decide.
"""
RESTORE_EXAMPLES = """\
example:
  echowing setup restore echowing-2-20261121-093000.params.json --vehicle /dev/ttyACM0
"""
SERIAL_PORTS = range(1, 10)
RANGEFINDERS = range(1, 10)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True)
    _add_check(_part(parts, "check", "report each item as fine or wrong, with reason and fix"))
    _add_apply(_part(parts, "apply", "write what is wrong; the old values are kept in a file"))
    _add_restore(_part(parts, "restore", "write back the values that apply has kept"))
    _add_lua(_part(parts, "lua", "copy the applet to the autopilot's SD card"))


def _part(parts: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, text: str):  # type: ignore[no-untyped-def]
    return parts.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _add_vehicle(parser: argparse.ArgumentParser) -> None:
    from echowing.mavlink.connection import CONN  # noqa: PLC0415 (imported when the verb is used)

    parser.add_argument(
        "--vehicle",
        required=True,
        metavar="CONN",
        help=f"{CONN}; CONN@ID where several vehicles share the link",
    )
    _add_link(parser)


def _add_link(parser: argparse.ArgumentParser) -> None:
    from echowing.mavlink.connection import DEFAULT_BAUD  # noqa: PLC0415 (imported when the verb is used)

    parser.add_argument(
        "--baud", type=int, default=DEFAULT_BAUD, help="baud rate of a serial device"
    )
    parser.add_argument(
        "--signing-key-file",
        type=Path,
        metavar="FILE",
        help="as for `echowing follow`. An autopilot with a key must accept unsigned messages on "
        "the co-processor's port (host_tools/SETUP.md, Signing)",
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
        help="use RNGFNDn, if another sensor uses RNGFND1 (1)",
    )
    parser.add_argument(
        "--sonar",
        metavar="FILE",
        help="the sonar file, as for `echowing follow`. check compares ECHO_DETECT and ECHO_INSET "
        "with it, apply sets them; a sensor that the autopilot reads itself needs no co-processor "
        f"(without: check takes {SHIPPED_SONAR}, apply leaves both)",
    )


def _add_applet(parser: argparse.ArgumentParser, *, replaces: bool = True) -> None:
    from echowing.applets import APPLETS, HOLD  # noqa: PLC0415 (imported when the verb is used)

    chosen = HOLD.name if replaces else None
    parser.add_argument(
        "--applet",
        choices=[applet.name for applet in APPLETS],
        default=chosen,
        help="hold: keeps the distance; speed: the thesis's, for autopilots with little memory "
        f"({chosen or 'the one that it runs'})",
    )
    if replaces:
        parser.add_argument(
            "--replace", action="store_true", help="take the other applet off the card"
        )
        parser.add_argument(
            "--release",
            type=Path,
            metavar="DIR",
            help="take the applet from this folder, which `make release` has written",
        )


def _add_check(parser: argparse.ArgumentParser) -> None:
    parser.epilog = CHECK_EXAMPLES
    _add_vehicle(parser)
    _add_wiring(parser)
    _add_applet(parser, replaces=False)
    parser.add_argument(
        "--role",
        choices=("follower", "leader"),
        default="follower",
        help="check the vehicle as this (follower); a leader needs no sonar and no applet",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _add_apply(parser: argparse.ArgumentParser) -> None:
    parser.epilog = APPLY_EXAMPLES
    _add_vehicle(parser)
    _add_wiring(parser)
    _add_applet(parser)
    parser.add_argument("--yes", action="store_true", help="write without asking")
    parser.add_argument(
        "--restart",
        action="store_true",
        help="restart the autopilot, wait for it, and write the parameters that exist only then",
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE",
        help="keep the old values in this file (echowing-ID-DATE.params.json); a file of the same "
        "vehicle is extended",
    )
    parser.add_argument(
        "--folder",
        help="folder of the scripts on the vehicle (found by itself: APM/scripts, or "
        "scripts in SITL)",
    )


def _add_restore(parser: argparse.ArgumentParser) -> None:
    parser.epilog = RESTORE_EXAMPLES
    parser.add_argument("file", type=Path, metavar="FILE", help="the file that apply has written")
    _add_vehicle(parser)
    parser.add_argument("--restart", action="store_true", help="restart the autopilot afterwards")


def _add_lua(parser: argparse.ArgumentParser) -> None:
    from echowing.mavlink.connection import CONN  # noqa: PLC0415 (imported when the verb is used)

    parser.epilog = LUA_EXAMPLES
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument(
        "--vehicle",
        metavar="CONN",
        help=f"over MAVLink (MAVFTP), disarmed; {CONN}; CONN@ID where several vehicles share the "
        "link",
    )
    way.add_argument(
        "--mount", type=Path, metavar="DIR", help="where the autopilot's SD card is mounted"
    )
    parser.add_argument(
        "--folder",
        default="APM/scripts",
        help="with --vehicle: folder of the scripts on the vehicle (APM/scripts; in SITL: scripts)",
    )
    _add_applet(parser)
    _add_link(parser)


def run(args: argparse.Namespace) -> int:
    """Run the part."""
    parts = {"check": _check, "apply": _apply, "restore": _restore, "lua": _lua}
    return parts[args.part](args)


def _tell(text: str) -> None:
    """Not on stdout, which may be JSON."""
    print(text, file=sys.stderr)


def _applet(args: argparse.Namespace) -> "Applet":
    """The applet that was asked for; of a release its file is checked now."""
    from dataclasses import replace  # noqa: PLC0415

    from echowing.applets import applet_named  # noqa: PLC0415
    from echowing.release import Release  # noqa: PLC0415

    applet = applet_named(args.applet)
    if args.release is None:
        return applet
    return replace(applet, source=Release(args.release).verified(applet.file))


@contextmanager
def _vehicle(where: str, args: argparse.Namespace) -> "Iterator[Vehicle]":
    from echowing.setup.vehicle import open_vehicle  # noqa: PLC0415

    key = args.signing_key_file
    with open_vehicle(where, baud=args.baud, signing_key_file=key, say=_tell) as vehicle:
        yield vehicle


# ---- check -------------------------------------------------------------------------------------


def _check(args: argparse.Namespace) -> int:
    from dataclasses import replace  # noqa: PLC0415

    from echowing.applets import applet_named  # noqa: PLC0415
    from echowing.setup.checks import examine, exit_code  # noqa: PLC0415
    from echowing.setup.reading import read_out  # noqa: PLC0415
    from echowing.setup.readout import Role  # noqa: PLC0415
    from echowing.setup.view import as_json, as_lines  # noqa: PLC0415
    from echowing.sonar_file import load_sonar  # noqa: PLC0415

    applet = None if args.applet is None else applet_named(args.applet)
    sonar = load_sonar(args.sonar or SHIPPED_SONAR)
    with _vehicle(args.vehicle, args) as vehicle:
        _tell(f"{vehicle.name}: listening and reading parameters …")
        readout = read_out(
            vehicle,
            args.serial,
            args.rangefinder,
            applet=applet,
            range_type=sonar.rangefinder_type,
        )
        readout = replace(readout, sonar=sonar.belief())
        role = Role(args.role)
        findings = examine(readout, role)
        system_id = vehicle.system_id
    if args.json:
        print(json.dumps(as_json(system_id, readout, findings, role), indent=2))
    else:
        print("\n".join(as_lines(system_id, readout, findings, role)))
    return exit_code(findings)


# ---- apply and restore -------------------------------------------------------------------------


def _apply(args: argparse.Namespace) -> int:
    from datetime import datetime  # noqa: PLC0415

    from echowing.setup.apply import default_file  # noqa: PLC0415
    from echowing.setup.job import Apply  # noqa: PLC0415
    from echowing.sonar_file import load_sonar  # noqa: PLC0415

    applet = _applet(args)
    sonar = load_sonar(args.sonar or SHIPPED_SONAR)
    with _vehicle(args.vehicle, args) as vehicle, progress_bar() as bar:
        _tell(f"{vehicle.name}: reading parameters …")
        job = Apply(
            _work(vehicle, args),
            (lambda question: True) if args.yes else agreed,
            bar,
            args.save or default_file(vehicle.system_id, datetime.now()),
            serial_port=args.serial,
            rangefinder=args.rangefinder,
            sonar=sonar,
            sonar_name=args.sonar,
            folder=None if args.folder is None else args.folder.strip("/"),
            applet=applet,
            release=args.release,
            replace=args.replace,
        )
        return job.run()


def _restore(args: argparse.Namespace) -> int:
    from echowing.setup.apply import load  # noqa: PLC0415
    from echowing.setup.job import restore  # noqa: PLC0415

    saved = load(args.file)
    with _vehicle(args.vehicle, args) as vehicle:
        return restore(_work(vehicle, args), args.file, saved)


def _work(vehicle: "Vehicle", args: argparse.Namespace) -> "Work":
    from echowing.setup.job import Work  # noqa: PLC0415

    return Work(vehicle, reached(args), lambda text: print(text, flush=True), args.restart)


def reached(args: argparse.Namespace) -> str:
    """What follows `--vehicle` in the next command that reaches the same vehicle."""
    from echowing.mavlink.connection import DEFAULT_BAUD  # noqa: PLC0415

    baud = "" if args.baud == DEFAULT_BAUD else f" --baud {args.baud}"
    key = args.signing_key_file
    signed = "" if key is None else f" --signing-key-file {shlex.quote(str(key))}"
    return f"{shlex.quote(args.vehicle)}{baud}{signed}"


def agreed(question: str) -> bool:
    """Ask the operator, or a program that writes to stdin."""
    print(question, end="", flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise EchowingError("no answer: the input has ended; give --yes to write without asking")
    return answer.strip().lower() in ("y", "yes")


# ---- lua ---------------------------------------------------------------------------------------


def _lua(args: argparse.Namespace) -> int:
    return _lua_on_card(args) if args.vehicle is None else _lua_over_link(args)


def _lua_on_card(args: argparse.Namespace) -> int:
    """Copy, verify, and say what is left to do."""
    from echowing.setup.applet import applet_path, checksum, install_on_card  # noqa: PLC0415

    applet = _applet(args)
    target = install_on_card(args.mount, applet, replace=args.replace)
    crc = checksum(applet_path(applet).read_bytes())
    print(f"{target}: written and verified, checksum {crc:08x}")
    print("Unmount the card; on the vehicle set SCR_ENABLE 1, restart, then ECHO_ENABLE 1.")
    return 0


def _lua_over_link(args: argparse.Namespace) -> int:
    from echowing.setup.applet import applet_path, install_over_link  # noqa: PLC0415
    from echowing.setup.ftp import FtpClient  # noqa: PLC0415
    from echowing.setup.ftp_format import ardupilot_crc32  # noqa: PLC0415

    applet = _applet(args)
    with _vehicle(args.vehicle, args) as vehicle:
        vehicle.refuse_armed("scripts are replaced")
        folder = args.folder.strip("/")
        with progress_bar() as bar:
            written = install_over_link(
                FtpClient(vehicle), bar, folder, applet, replace=args.replace
            )
        crc = ardupilot_crc32(applet_path(applet).read_bytes())
        state = "written, read back" if written else "the same applet is there already"
        print(f"{folder}/{applet.file}: {state}, ArduPilot's CRC-32 {crc:08x}")
        print(_restart_scripts(vehicle))
    return 0


@contextmanager
def progress_bar() -> "Iterator[Callable[[str], Progress]]":
    """A bar for each step; lines where nobody watches.

    A bar that is shown takes over what is printed, and reads `[y/N]` as a style: so none is left
    when a step is done, and nothing is taken over.
    """
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
    with ExitStack() as shown:

        def step(title: str) -> Callable[[int, int], None]:
            shown.close()
            console = Console(stderr=True)
            bars = Progress(*columns, console=console, redirect_stdout=False, redirect_stderr=False)
            shown.enter_context(bars)
            task = bars.add_task(title, total=None)

            def update(done: int, total: int) -> None:
                bars.update(task, completed=done, total=total)
                if done >= total:
                    shown.close()

            return update

        yield step


def _restart_scripts(vehicle: "Vehicle") -> str:
    """Have the autopilot load its scripts again; returns the outcome in words."""
    from echowing.setup.reading import objections  # noqa: PLC0415
    from echowing.setup.restart import (  # noqa: PLC0415
        restart_scripts,
        scripting_error,
        until_applet_runs,
    )

    if vehicle.read(["SCR_ENABLE"]).get("SCR_ENABLE") != 1.0:
        return "scripting is off; next: echowing setup apply --restart"
    if vehicle.armed:
        return "the vehicle is armed now: restart the autopilot when it is disarmed"
    if not restart_scripts(vehicle):
        return "restart the autopilot: it does not restart scripts by command"
    if until_applet_runs(vehicle):
        return "the applet runs; next: echowing setup apply, then echowing setup check"
    error = scripting_error(objections(vehicle))
    return f"the applet does not run: {error or 'it is not loaded; restart the autopilot'}"
