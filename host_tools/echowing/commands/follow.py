"""`echowing follow`: guide real followers behind a real leader."""

import argparse
import json
import math
import sys
import time
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from echowing.errors import EchowingError
from echowing.flight.lowest import LOWEST_M
from echowing.paths import SHIPPED_SONAR

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from echowing.flight.belief import SonarBelief
    from echowing.flight.guidance import Slot
    from echowing.flight.reshape import Named
    from echowing.flight.take_off import TakeOff
    from echowing.mavlink.seats import Seat
    from echowing.tool.run import FollowOptions, Page

RADIUS_M = 3.0
# Above the leader's home: what can be flown, and what can still be seen from there.
MOST_ALTITUDE_M = 500.0
# Over a leader that is carried at a metre or two.
CARRIED_ALTITUDE_M = 10.0
# Longer than any turn of the flying loop: what is not back by then never comes back.
PATIENCE_S = 3.0
LOG_FOLDER = Path("out/flights")

EXAMPLES = """\
examples:
  echowing follow --leader udpin:14550 --follower udpin:14560
      only watches; with --engage it sends points to followers that fly in Guided
  echowing follow --leader /dev/ttyUSB0 --follower /dev/ttyUSB1 --baud 57600 --radius 8 --engage
  echowing follow --leader udpin:14550@1 --follower udpin:14550@2 --follower udpin:14550@3 \\
      --formation vee --spacing 3.5 --stop-switch 7:1700 --log out/vee-7 --engage
      all vehicles on one link, each with a system id of its own. Slots of your own:
      --formation mine.toml
          [[slots]]
          radius_m = 4.0
          angle_deg = 40.0
          [[slots]]
          radius_m = 4.0
          angle_deg = -40.0
  echowing follow --leader udpin:14550 --follower udpin:14560 --web
      only watches, and shows the flight in the browser; add --web-address 0.0.0.0 for a phone
  echowing follow --leader udpin:14550 --follower udpin:14560 --take-off 10 --engage
      takes off first: each pilot arms the vehicle in Guided, on the ground; the tool never arms
  echowing follow --leader udpin:14550 --follower udpin:14560 \\
      --signing-key-file field.key --engage
  echowing follow --leader udpin:14550 --follower udpin:14560 --build-up 8,5,4,3
      keys of the live view engage, hold, go nearer and stop: host_tools/KEYS.md
The pilot takes over by any change of mode. When the pilot returns to Guided, points go on.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    from echowing.flight.guidance import GuidanceSettings  # noqa: PLC0415 (when the verb is used)
    from echowing.flight.shapes import SHAPES  # noqa: PLC0415
    from echowing.mavlink.connection import CONN, DEFAULT_BAUD  # noqa: PLC0415
    from echowing.web.options import add_web_arguments  # noqa: PLC0415

    parser.epilog = EXAMPLES
    links = parser.add_argument_group(
        "vehicles",
        f"CONN: {CONN}; CONN@ID where several vehicles share a link",
    )
    leader = links.add_mutually_exclusive_group(required=True)
    leader.add_argument("--leader", metavar="CONN", help="the leader")
    leader.add_argument(
        "--leader-from",
        dest="leader",
        metavar="udp:[HOST:]PORT",
        help="receive the leader from `echowing leader` on another computer; with HOST: listen "
        "on this address only",
    )
    links.add_argument(
        "--follower",
        action="append",
        required=True,
        metavar="CONN",
        help="a follower; give one --follower for each",
    )
    links.add_argument("--baud", type=int, default=DEFAULT_BAUD, help="baud rate of serial devices")
    place = parser.add_argument_group("formation")
    radius = place.add_mutually_exclusive_group()
    radius.add_argument("--radius", type=float, metavar="M", help="distance from the leader (3)")
    radius.add_argument(
        "--build-up",
        metavar="M,M,...",
        help="radii to fly one after the other, the largest first (8,5,4,3). Key n of the live "
        "view goes to the next radius, key b back. The tool sets ECHO_DIST to each radius and "
        "restores it at the end. With --formation: the radii of its nearest slot",
    )
    place.add_argument(
        "--angle",
        type=float,
        default=0.0,
        metavar="DEG",
        help="angle off the leader's tail, counter-clockwise (0)",
    )
    place.add_argument(
        "--formation",
        metavar="SHAPE,…|FILE",
        help=f"a shape: {', '.join(SHAPES)}; or a TOML file with one slot per follower. Of several "
        "shapes the first is flown, and key f of the live view lets all fly into the next",
    )
    place.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="of a shape: distance from each follower to the vehicle that its sonar looks at (3)",
    )
    place.add_argument(
        "--close-gaps",
        action="store_true",
        help="who flies behind a follower that has left takes its slot after 5 s; without it who "
        "is behind holds",
    )
    place.add_argument(
        "--altitude",
        type=float,
        metavar="M",
        help="height of the followers above the leader's home (the leader's height when a follower "
        "is engaged; with --carried-leader: 10). A follower that is more than 3 m above or below "
        "that is engaged only if you give --altitude",
    )
    place.add_argument(
        "--lead-time",
        type=float,
        default=GuidanceSettings().lead_time_s,
        metavar="S",
        help="with --position-only: how far points lie ahead of the slot, in seconds of flight; a "
        "copter trails its points by about 1.4 s",
    )
    place.add_argument(
        "--sonar",
        default=SHIPPED_SONAR,
        metavar="FILE",
        help="what is believed of the followers' sonars: a sonar file (.toml), as `echowing rig "
        "response-matrix` writes it, or the name of one that is shipped (mb1202)",
    )
    place.add_argument(
        "--legs",
        choices=("foil", "stock"),
        default="foil",
        help="what every vehicle that a sonar looks at has around its legs: foil, or nothing "
        "(stock), and is then heard less far (foil)",
    )
    place.add_argument(
        "--rate", type=float, default=8.0, metavar="HZ", help="points per second, up to 20 (8)"
    )
    links.add_argument(
        "--leader-rate",
        type=float,
        default=4.0,
        metavar="HZ",
        help="leader positions per second, up to 20 (4); choose what its radio can carry",
    )
    place.add_argument(
        "--position-only",
        action="store_true",
        help="send points without a velocity; the applet then keeps the distance by its "
        "speed limit",
    )
    _add_safety(parser.add_argument_group("safety"))
    links.add_argument(
        "--signing-key-file",
        type=Path,
        metavar="FILE",
        help="sign all messages, and refuse messages that are not signed with the same key "
        "(MAVLink 2). FILE holds 32 bytes, 64 hexadecimal digits or a pass phrase. Co-processors "
        "do not sign: the range then comes from the autopilot's DISTANCE_SENSOR, and the gimbal's "
        "state is not known",
    )
    add_log_arguments(parser)
    add_web_arguments(parser)
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")


def add_log_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the flight is logged."""
    log = parser.add_mutually_exclusive_group()
    log.add_argument(
        "--log",
        type=Path,
        metavar="DIR",
        help=f"write the logs of the flight here ({LOG_FOLDER}/DATE-TIME)",
    )
    log.add_argument("--no-log", action="store_true", help="write no log")


def log_folder(args: argparse.Namespace) -> Path | None:
    """The folder of --log, or one named by the current time; None: no log."""
    if args.no_log:
        return None
    return args.log or LOG_FOLDER / time.strftime("%Y%m%d-%H%M%S")


def _add_safety(safety: "argparse._ArgumentGroup") -> None:
    from echowing.flight.envelope import LEAST_M  # noqa: PLC0415

    safety.add_argument(
        "--engage", action="store_true", help="send points; without --engage the tool only watches"
    )
    safety.add_argument(
        "--simulated",
        action="store_true",
        help="the vehicles are simulated (ArduCopter SITL, sim --serve): take slots `behind` "
        "another one, too",
    )
    safety.add_argument(
        "--take-off",
        type=float,
        metavar="M",
        help="first let the followers take off to this altitude, one after the other: only those "
        "that their pilots have armed in Guided on the ground. Each take-off begins 3 s after the "
        "tool has announced it",
    )
    safety.add_argument(
        "--next-at",
        type=float,
        metavar="M",
        help="with --take-off: height of one follower from which the next one takes off (80%% of "
        "--take-off)",
    )
    safety.add_argument(
        "--stop-switch",
        metavar="CH:PWM[:MODE]",
        help="stop a follower while channel CH of its transmitter is above PWM microseconds; the "
        "leader's transmitter stops all followers. With MODE (LOITER, BRAKE, LAND or RTL) the "
        "follower also changes to this mode",
    )
    safety.add_argument(
        "--max-distance",
        type=float,
        default=100.0,
        metavar="M",
        help="stop a follower that is further away (100)",
    )
    safety.add_argument(
        "--min-separation",
        type=float,
        default=LEAST_M,
        metavar="M",
        help="distance that is certain to remain between any two vehicles (1.0): a follower that "
        "would come nearer slows down, gives way or backs off",
    )
    safety.add_argument(
        "--home-difference",
        type=float,
        default=5.0,
        metavar="M",
        help="stop a follower whose home is more than this above or below the leader's (5)",
    )
    homes = safety.add_mutually_exclusive_group()
    homes.add_argument(
        "--level-homes",
        action="store_true",
        help="the homes are at one height: a difference is an error of the GPS receivers; do not "
        "correct the altitude by it",
    )
    homes.add_argument(
        "--correct-homes",
        action="store_true",
        help="the homes are not at one height: correct the altitude by the difference. Without "
        "--level-homes or --correct-homes a follower whose home differs by more than 1 m is not "
        "engaged",
    )
    safety.add_argument(
        "--carried-leader",
        action="store_true",
        help="the leader does not fly: it is carried on foot, or stands on the ground",
    )


def run(args: argparse.Namespace) -> int:
    """Follow until asked to end."""
    from echowing.web.open import page_of  # noqa: PLC0415

    return fly(_options(args), as_json=args.json, page=page_of(args, "follow"))


def fly(
    options: "FollowOptions",
    *,
    as_json: bool,
    page: "AbstractContextManager[Page | None] | None" = None,
) -> int:
    """Fly with these options, with keys if a terminal shows their effect; returns the exit code."""
    from echowing.stopping import stop_on_signals  # noqa: PLC0415
    from echowing.terminal import Keyboard, run_in_flight  # noqa: PLC0415
    from echowing.tool.run import FollowTool  # noqa: PLC0415
    from echowing.tool.view import open_view  # noqa: PLC0415

    pressed = Keyboard()
    seen = pressed.is_there and sys.stdout.isatty() and not as_json
    for option, given in (("--build-up", options.build_up), ("another shape", options.shapes)):
        if given and not seen:
            raise EchowingError(f"{option} needs keys: run it on a terminal, without --json")
    keyboard = pressed if seen else None
    with stop_on_signals(PATIENCE_S) as stop, page or nullcontext() as shown:
        keys = None if keyboard is None else keyboard.read
        view = open_view(as_json=as_json)
        tool = FollowTool(options, view, stop, keys=keys, page=shown)
        return run_in_flight(tool.run, lambda: tool.stuck, keyboard)


def options_of(arguments: "Sequence[str]") -> "FollowOptions":
    """The options of a command line, without the verb."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return _options(parser.parse_args(arguments))


def _options(args: argparse.Namespace) -> "FollowOptions":
    from echowing.flight.guard import Limits  # noqa: PLC0415
    from echowing.flight.guidance import GuidanceSettings  # noqa: PLC0415
    from echowing.flight.readiness import Readiness  # noqa: PLC0415
    from echowing.flight.switch import parse_stop_switch  # noqa: PLC0415
    from echowing.mavlink.seats import VehicleFinder  # noqa: PLC0415
    from echowing.mavlink.signing import read_key  # noqa: PLC0415
    from echowing.sonar_file import FlownBy, load_sonar  # noqa: PLC0415
    from echowing.tool.run import FollowOptions  # noqa: PLC0415

    _check_numbers(args)
    switch = None if args.stop_switch is None else parse_stop_switch(args.stop_switch)
    seats = _seats(args)
    VehicleFinder(seats)  # refuses what could never be distinguished
    radii_m = _build_up(args)
    flown_by = FlownBy(args.sonar, load_sonar(args.sonar), args.legs)
    sonar = flown_by.file.belief(args.legs)
    wanted = _wanted(args)
    slots = _slots(args, wanted, radii_m, sonar)
    altitude_m = CARRIED_ALTITUDE_M if args.carried_leader else None
    altitude_m = altitude_m if args.altitude is None else args.altitude
    _check_heights(slots, altitude_m)
    return FollowOptions(
        seats=seats,
        slots=slots,
        settings=GuidanceSettings(
            lead_time_s=args.lead_time,
            feed_forward=not args.position_only,
            close_gaps=wanted.close_gaps,
        ),
        sonar=sonar,
        altitude_m=altitude_m,
        rate_hz=args.rate,
        limits=Limits(
            max_distance_m=args.max_distance,
            min_separation_m=args.min_separation,
            home_difference_m=args.home_difference,
            level_homes=args.level_homes,
            leader_flies=not args.carried_leader,
            switch=switch,
            ready=Readiness(
                homes_told=args.level_homes or args.correct_homes,
                height_told=args.altitude is not None,
            ),
        ),
        engage=args.engage,
        take_off=_take_off(args),
        leader_rate_hz=args.leader_rate,
        duration_s=args.duration,
        log=log_folder(args),
        flown_by=flown_by,
        signing_key=read_key(args.signing_key_file),
        build_up=radii_m,
        shapes=wanted.shapes,
    )


def _take_off(args: argparse.Namespace) -> "TakeOff | None":
    from echowing.flight.take_off import ARRIVED_M, NEXT_SHARE, TakeOff  # noqa: PLC0415

    altitude_m, next_at_m = args.take_off, args.next_at
    if altitude_m is None:
        if next_at_m is not None:
            raise EchowingError("--next-at needs --take-off")
        return None
    if not LOWEST_M <= altitude_m <= 100.0:
        raise EchowingError(f"--take-off {altitude_m:g}: give {LOWEST_M:g} to 100")
    if next_at_m is None:
        next_at_m = NEXT_SHARE * altitude_m
    if not 1.0 <= next_at_m <= altitude_m - ARRIVED_M:
        raise EchowingError(f"--next-at {next_at_m:g}: give 1 to {altitude_m - ARRIVED_M:g}")
    return TakeOff(altitude_m, next_at_m)


def _check_numbers(args: argparse.Namespace) -> None:
    """Refuse what could not be flown. Each: option, least and greatest value."""
    spans = {
        "--lead-time": (args.lead_time, 0.0, 5.0),
        "--rate": (args.rate, 1.0, 20.0),
        "--leader-rate": (args.leader_rate, 1.0, 20.0),
        "--altitude": (
            LOWEST_M if args.altitude is None else args.altitude,
            LOWEST_M,
            MOST_ALTITUDE_M,
        ),
        "--max-distance": (args.max_distance, 5.0, 10_000.0),
        "--min-separation": (args.min_separation, 0.5, 1_000.0),
        "--home-difference": (args.home_difference, 0.0, 1_000.0),
        "--baud": (args.baud, 1_200, 4_000_000),
        "--duration": (0.0 if args.duration is None else args.duration, 0.0, math.inf),
    }
    for option, (value, least, most) in spans.items():
        if not least <= value <= most:
            raise EchowingError(f"{option} {value:g}: give {least:g} to {most:g}")


def _check_heights(slots: "Sequence[Slot]", altitude_m: float | None) -> None:
    """Refuse a slot whose altitude step leads into the ground, or out of sight.

    Without an altitude what no leader's height could make flyable; the rest is seen in the air.
    """
    for number, slot in enumerate(slots, 1):
        height_m = slot.altitude_step_m + (altitude_m or 0.0)
        if altitude_m is None and abs(height_m) < MOST_ALTITUDE_M - LOWEST_M:
            continue
        if not LOWEST_M <= height_m <= MOST_ALTITUDE_M:
            raise EchowingError(
                f"slot {number} would be flown at {height_m:g} m, --altitude and its "
                f"altitude_step_m: give {LOWEST_M:g} to {MOST_ALTITUDE_M:g}"
            )


def _seats(args: argparse.Namespace) -> "list[Seat]":
    from echowing.mavlink.seats import parse_seat  # noqa: PLC0415

    leader = parse_seat("leader", args.leader, args.baud)
    return [leader, *(parse_seat("follower", text, args.baud) for text in args.follower)]


def _build_up(args: argparse.Namespace) -> tuple[float, ...]:
    """The radii of --build-up, none without it."""
    text = args.build_up
    if text is None:
        return ()
    try:
        radii_m = tuple(float(part) for part in text.split(","))
    except ValueError:
        radii_m = ()
    falling = all(one > after for one, after in pairwise(radii_m))
    if len(radii_m) < 2 or not falling or not all(1.0 <= one <= 1_000.0 for one in radii_m):
        raise EchowingError(
            f"--build-up {text}: give two radii or more, each smaller than the one before, for "
            "example 8,5,4,3"
        )
    return radii_m


def _slots(
    args: argparse.Namespace,
    wanted: "_Wanted",
    radii_m: tuple[float, ...],
    sonar: "SonarBelief",
) -> "list[Slot]":
    """A checked slot for each follower; of a build-up at its widest."""
    from echowing.flight.build_up import scaled  # noqa: PLC0415
    from echowing.flight.reshape import check_changes  # noqa: PLC0415
    from echowing.tool.formation_file import check_to_be_led  # noqa: PLC0415

    slots = wanted.slots
    if wanted.shapes and radii_m:
        raise EchowingError("--build-up takes one shape: leave the others out of --formation")
    later = [shape for _, shape in wanted.shapes[1:]]
    said: list[str] = []
    try:
        for one in [slots, *later, *(scaled(slots, one_m) for one_m in radii_m)]:
            said += check_to_be_led(
                one,
                sonar,
                args.min_separation,
                wanted.separation_m,
                simulated=args.simulated,
                close_gaps=wanted.close_gaps,
            )
        check_changes([*wanted.shapes, *wanted.shapes[:1]])
    except EchowingError as error:
        where = "" if args.formation is None else f"--formation {args.formation}: "
        raise EchowingError(f"{where}{error}") from error
    for line in dict.fromkeys(said):
        if args.json:
            print(json.dumps({"time_s": 0.0, "event": line}))
        else:
            print(f"echowing: {line}", file=sys.stderr)
    nearest_m = min(radii_m, default=min(slot.radius_m for slot in slots))
    if nearest_m <= args.min_separation:
        raise EchowingError(
            f"a slot {nearest_m:g} m from the leader is inside --min-separation "
            f"{args.min_separation:g} m; move it out, or the follower will never get there"
        )
    return scaled(slots, radii_m[0]) if radii_m else list(slots)


class _Wanted(NamedTuple):
    """The slots as they are asked for, how far apart they have to be, and whether gaps close.

    shapes: if there are several, all of them, the first one too.
    """

    slots: "Sequence[Slot]"
    separation_m: float | None
    close_gaps: bool
    shapes: "Sequence[Named]" = ()


def _wanted(args: argparse.Namespace) -> _Wanted:
    from echowing.flight.guidance import Slot  # noqa: PLC0415
    from echowing.flight.shapes import SHAPES, shape  # noqa: PLC0415
    from echowing.tool.formation_file import load_formation  # noqa: PLC0415

    followers, name = len(args.follower), args.formation
    names = [] if name is None else [one.strip() for one in name.split(",")]
    if any(one in SHAPES for one in names):
        spacing_m = RADIUS_M if args.spacing is None else args.spacing
        formed = [(one, shape(one, followers, spacing_m)) for one in names]
        several = formed if len(formed) > 1 else []
        return _Wanted(formed[0][1], None, args.close_gaps, several)
    if args.spacing is not None:
        raise EchowingError(f"--spacing needs --formation {' or '.join(SHAPES)}")
    if name is None:
        if followers > 1:
            raise EchowingError(
                f"{followers} followers need --formation: {', '.join(SHAPES)}, or a FILE with a "
                "slot for each"
            )
        radius_m = RADIUS_M if args.radius is None else args.radius
        return _Wanted([Slot(radius_m, math.radians(args.angle))], None, args.close_gaps)
    formation = load_formation(Path(name))
    slots = [section.slot() for section in formation.slots]
    if len(slots) != followers:
        raise EchowingError(f"--formation {name}: {len(slots)} slots for {followers} followers")
    closes = args.close_gaps or formation.close_gaps
    shapes = formation.shapes() if formation.changes else []
    return _Wanted(slots, formation.slot_separation_m, closes, shapes)
