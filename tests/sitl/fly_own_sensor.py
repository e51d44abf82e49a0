"""A sonar that the autopilot reads by its own driver: no co-processor, no gimbal."""

import math
from importlib import resources
from pathlib import Path

from echowing.bench.accuracy import Goal

from .fly_robust import SEED, fly_and_enter
from .formation import FOLLOWER, Kit, two_commands
from .plugin import Start
from .serial_sonar import RANGEFINDER_TYPE, WIRING, SerialSonar
from .table import Entry
from .vehicle import Vehicle

# Receivers alone leave a larger error: the sonar was heard, and held by.
GOAL = Goal(mean_error_m=0.3, rmsd_m=math.inf, least_m=1.0)
ANOTHER_TYPE = ("rangefinder_type = 2", f"rangefinder_type = {RANGEFINDER_TYPE}")


def test_own_sensor(kit: Kit, start: Start, table: list[Entry], case_folder: Path) -> None:
    shipped = (resources.files("echowing") / "sonars" / "mb1202-fixed.toml").read_text("utf-8")
    sonar = case_folder / "serial.toml"
    sonar.write_text(shipped.replace(*ANOTHER_TYPE), encoding="utf-8")
    prepared = _prepare(kit, case_folder / "prepared", sonar)

    formation = start(SEED, wandering=False, reads_itself=True, prepared=prepared)
    case, options = "sonar read by the autopilot", ("--sonar", str(sonar))
    fly_and_enter(formation, table, case, GOAL, *options)


def _prepare(kit: Kit, folder: Path, sonar: Path) -> Path:
    """A follower's folder after README's two commands, with that sonar on SERIAL2."""
    plugged = SerialSonar()
    follower = Vehicle(kit.binary, FOLLOWER, folder, factory=WIRING, serial2=plugged.line)
    try:
        plugged.ride(follower)
        follower.until_heard()
        two_commands(follower, "--sonar", str(sonar))
        return folder
    finally:
        follower.close()
        plugged.end()
