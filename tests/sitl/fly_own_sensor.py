"""A sonar that the autopilot reads by its own driver: no co-processor, no gimbal."""

from importlib import resources
from pathlib import Path

from .formation import FOLLOWER, Kit, rectangle
from .plugin import Start
from .serial_sonar import RANGEFINDER_TYPE, WIRING, SerialSonar
from .table import Entry, Figures
from .tools import run
from .vehicle import Vehicle

SEED, SPEED_MPS = 1, 2.0
BEGIN_S, END_S = 25.0, 145.0
LEAST_M = 1.0
# Receivers alone leave more: the sonar was heard, and held by.
MOST_M = 0.3
ANOTHER_TYPE = ("rangefinder_type = 2", f"rangefinder_type = {RANGEFINDER_TYPE}")


def test_own_sensor(kit: Kit, start: Start, table: list[Entry], case_folder: Path) -> None:
    shipped = (resources.files("echowing") / "sonars" / "mb1202-fixed.toml").read_text("utf-8")
    sonar = case_folder / "serial.toml"
    sonar.write_text(shipped.replace(*ANOTHER_TYPE), encoding="utf-8")
    prepared = _prepare(kit, case_folder / "prepared", sonar)

    formation = start(SEED, wandering=False, reads_itself=True, prepared=prepared)
    formation.leader.upload(rectangle(formation), 10.0)
    tool = formation.fly_in_formation("--sonar", str(sonar))
    began_s = formation.fly_mission(tool, SPEED_MPS, END_S)
    flown = formation.measured(began_s + BEGIN_S, began_s + END_S)
    figures = Figures(
        flown.mean_separation_m, flown.mean_abs_error_m, flown.rmsd_m, flown.min_separation_m
    )
    note = formation.note(began_s)
    table.append(Entry(kit.version.line, "sonar read by the autopilot", figures, note=note))
    assert formation.least_m(began_s, began_s + END_S) >= LEAST_M
    assert flown.mean_abs_error_m < MOST_M


def _prepare(kit: Kit, folder: Path, sonar: Path) -> Path:
    """A follower's folder after README's two commands, with that sonar on SERIAL2."""
    plugged = SerialSonar()
    follower = Vehicle(kit.binary, FOLLOWER, folder, factory=WIRING, serial2=plugged.line)
    try:
        plugged.ride(follower)
        follower.until_heard()
        vehicle = ("--vehicle", follower.link())
        run("setup", "lua", *vehicle, "--folder", "scripts")
        kept = ("--save", str(folder / "old.params.json"))
        run("setup", "apply", *vehicle, "--sonar", str(sonar), "--yes", "--restart", *kept)
        return folder
    finally:
        follower.close()
        plugged.end()
