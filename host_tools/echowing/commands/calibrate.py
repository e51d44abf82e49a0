"""`echowing calibrate`: replay recorded flights through the copter model."""

import argparse
import json
import math
from pathlib import Path

from echowing.errors import EchowingError

EXAMPLES = """\
examples:
  echowing calibrate recordings/
  echowing calibrate recordings/ --generation 4.6 --json

A recording is a CSV with the columns time_s, north_m, east_m, down_m, vn_mps, ve_mps, vd_mps,
yaw_rad and the command in force: cmd_n, cmd_e, cmd_vn, cmd_ve, speed_cap. A recording without
command columns is an Auto mission; its corners are found in the track. Recordings in a folder named
after a generation (4.5, 4.6, 4.7, 4.8) are replayed with it, all others with --generation, or 4.8.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES
    parser.add_argument("folder", type=Path, metavar="DIR", help="a folder of recordings (*.csv)")
    parser.add_argument(
        "--generation",
        choices=("4.5", "4.6", "4.7", "4.8"),
        help="the ArduCopter generation that flew all of them",
    )
    parser.add_argument(
        "--wind",
        type=float,
        nargs=2,
        metavar=("M/S", "FROM_DEG"),
        default=(0.0, 0.0),
        help="mean wind during all of them: speed, and the bearing it came from",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON list")


def run(args: argparse.Namespace) -> int:
    """Replay and print."""
    from echowing.bench.calibrate import replay_directory  # noqa: PLC0415 (imported when used)
    from echowing.sim.vehicle.parameters import Generation  # noqa: PLC0415

    generation = Generation(args.generation) if args.generation else None
    results = replay_directory(args.folder, generation, _air_ned_mps(*args.wind))
    if args.json:
        rows = [
            {
                "recording": result.name,
                "kind": result.kind,
                "generation": result.generation,
                "rms_position_error_m": round(result.rms_position_error_m, 4),
                "max_error_m": round(result.max_error_m, 4),
                "duration_s": round(result.duration_s, 2),
            }
            for result in results
        ]
        print(json.dumps(rows, indent=2))
        return 0
    width = max(len(result.name) for result in results)
    print(f"{'recording':<{width}}  {'kind':<8}  ArduCopter  RMS error  largest  length")
    for result in results:
        print(
            f"{result.name:<{width}}  {result.kind:<8}  {result.generation:<10}  "
            f"{result.rms_position_error_m:7.3f} m  {result.max_error_m:5.2f} m  "
            f"{result.duration_s:4.0f} s"
        )
    return 0


def _air_ned_mps(speed_mps: float, from_deg: float) -> tuple[float, float, float]:
    """Velocity of the air of a wind."""
    if not (0.0 <= speed_mps < math.inf and math.isfinite(from_deg)):
        raise EchowingError(
            f"--wind {speed_mps:g} {from_deg:g}: give a speed of 0 m/s or more, and degrees"
        )
    bearing_rad = math.radians(from_deg)
    return -speed_mps * math.cos(bearing_rad), -speed_mps * math.sin(bearing_rad), 0.0
