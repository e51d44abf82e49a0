"""`echowing relay`: keep a vehicle midway between the ground station and a remote vehicle."""

import argparse
from pathlib import Path

from echowing.commands.follow import add_log_arguments, fly, log_folder
from echowing.errors import EchowingError
from echowing.flight.lowest import LOWEST_M

ALTITUDE_M = 30.0

EXAMPLES = """\
examples:
  echowing relay --remote udpin:14550 --vehicle udpin:14560 --ground 39.3400,-86.0300 --altitude 40
      only watches; with --engage it sends points to the relay while it flies in Guided
The messages call the remote vehicle the leader and the relay its follower. The relay's pilot takes
over by any change of mode.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    from echowing.mavlink.connection import CONN, DEFAULT_BAUD  # noqa: PLC0415 (imported when the verb is used)

    parser.epilog = EXAMPLES
    parser.add_argument("--remote", required=True, metavar="CONN", help="the remote vehicle")
    parser.add_argument(
        "--vehicle",
        required=True,
        metavar="CONN",
        help=f"the relay; CONN: {CONN}; CONN@ID on a shared link",
    )
    parser.add_argument(
        "--ground", required=True, metavar="LAT,LON", help="place of the ground station"
    )
    parser.add_argument(
        "--altitude",
        type=float,
        metavar="M",
        help="height above the relay's home (30). A relay that is more than 3 m above or below "
        "that is engaged only if you give --altitude. Keep it 5 m or more away from the heights at "
        "which the remote vehicle flies and comes back (RTL_ALT); the tool warns if it is not",
    )
    parser.add_argument(
        "--baud", type=int, default=DEFAULT_BAUD, help="baud rate of serial devices"
    )
    parser.add_argument(
        "--rate", type=float, default=4.0, metavar="HZ", help="points per second (4)"
    )
    parser.add_argument(
        "--engage", action="store_true", help="send points; without --engage the tool only watches"
    )
    parser.add_argument("--stop-switch", metavar="CH:PWM[:MODE]", help="as for `echowing follow`")
    parser.add_argument(
        "--max-distance",
        type=float,
        default=5_000.0,
        metavar="M",
        help="stop the relay if the remote vehicle is further away (5000)",
    )
    parser.add_argument(
        "--min-separation",
        type=float,
        default=10.0,
        metavar="M",
        help="distance that is certain to remain between the two vehicles (10): the relay gives "
        "way. It flies at this distance and 5 m more beside the line to the remote vehicle, so "
        "that a remote vehicle that comes back along the line does not meet it",
    )
    parser.add_argument(
        "--signing-key-file", type=Path, metavar="FILE", help="as for `echowing follow`"
    )
    add_log_arguments(parser)
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")


def run(args: argparse.Namespace) -> int:
    """Relay until asked to end."""
    from echowing.flight.guard import Limits  # noqa: PLC0415
    from echowing.flight.guidance import Slot  # noqa: PLC0415
    from echowing.flight.readiness import Readiness  # noqa: PLC0415
    from echowing.flight.relay import (  # noqa: PLC0415
        BESIDE_M,
        HEIGHTS_APART_M,
        RELAY_SETTINGS,
        RelayGuide,
        parse_ground,
    )
    from echowing.flight.switch import parse_stop_switch  # noqa: PLC0415
    from echowing.mavlink.seats import parse_seat  # noqa: PLC0415
    from echowing.mavlink.signing import read_key  # noqa: PLC0415
    from echowing.sonar_file import shipped_sonar  # noqa: PLC0415
    from echowing.tool.run import FollowOptions  # noqa: PLC0415

    altitude_told = args.altitude is not None
    args.altitude = args.altitude if altitude_told else ALTITUDE_M
    _check_numbers(args)
    ground = parse_ground(args.ground)
    options = FollowOptions(
        seats=[
            parse_seat("remote", args.remote, args.baud),
            parse_seat("relay", args.vehicle, args.baud),
        ],
        slots=[Slot(0.0)],
        settings=RELAY_SETTINGS,
        sonar=shipped_sonar(),
        altitude_m=args.altitude,
        rate_hz=args.rate,
        limits=Limits(
            max_distance_m=args.max_distance,
            min_separation_m=args.min_separation,
            leader_flies=False,
            ready=Readiness(
                any_applet=True,
                distance=False,
                reversal=False,
                sides=False,
                height_told=altitude_told,
                apart_m=HEIGHTS_APART_M,
            ),
            switch=None if args.stop_switch is None else parse_stop_switch(args.stop_switch),
        ),
        engage=args.engage,
        duration_s=args.duration,
        log=log_folder(args),
        signing_key=read_key(args.signing_key_file),
        make_guide=lambda: RelayGuide(ground, args.min_separation + BESIDE_M),
    )
    return fly(options, as_json=args.json)


def _check_numbers(args: argparse.Namespace) -> None:
    spans = {
        "--altitude": (args.altitude, LOWEST_M, 500.0),
        # Slower than the applet's stream watchdog allows, the relay would stop between points.
        "--rate": (args.rate, 2.0, 20.0),
        "--max-distance": (args.max_distance, 5.0, 50_000.0),
        "--min-separation": (args.min_separation, 1.0, 1_000.0),
    }
    for option, (value, least, most) in spans.items():
        if not least <= value <= most:
            raise EchowingError(f"{option} {value:g}: give {least:g} to {most:g}")
