"""A vehicle as from the factory becomes ready by README's two commands, and refuses to arm else."""

from pathlib import Path

from . import loopback
from .formation import FOLLOWER, Follower, Kit, Preparation, copied, rest
from .relay import LOOPBACK
from .sonar import silence
from .tools import run
from .vehicle import GUIDED, Vehicle

BOARD = 191  # COMP_ID of the co-processor, as it is delivered
REFUSAL_S = 30.0
CHECKED_S = 3.0  # the applet looks whether it can fly once a second


def test_readmes_two_commands_make_it_ready(preparation: Preparation) -> None:
    lua, applied = preparation.said
    assert "once more" not in lua + applied
    assert "WRONG" not in preparation.check, preparation.check
    counts = preparation.check.splitlines()[-1]  # it leaves out what it has none of
    assert "fine" in counts and "wrong" not in counts and "not to be told" not in counts
    assert "fine   co-processor" in preparation.check
    assert "fine   applet" in preparation.check


def test_nothing_listens_but_on_loopback(kit: Kit, case_folder: Path) -> None:
    vehicle = Vehicle(kit.binary, FOLLOWER, case_folder / "vehicle")
    try:
        vehicle.until_heard()
        assert f"0.0.0.0:{vehicle.usb}" in vehicle.listening()  # or nothing would be proved here
        assert loopback.reachable_interfaces() == []
    finally:
        vehicle.close()


def test_arming_is_refused_without_co_processor(kit: Kit, case_folder: Path) -> None:
    vehicle = Vehicle(kit.binary, FOLLOWER, copied(kit.prepared, case_folder / "v"), fresh=False)
    try:
        vehicle.until_positioned()
        vehicle.set_mode(GUIDED)
        said = _refused(vehicle)
        assert any("Rangefinder 1" in text for text in said), said
        emulated = Follower(vehicle, silence)
        try:
            vehicle.arm()  # nothing else was in the way
        finally:
            emulated.unplug()
    finally:
        vehicle.close()


def test_arming_is_refused_without_a_sonar_that_looks_forward(kit: Kit, case_folder: Path) -> None:
    vehicle = Vehicle(kit.binary, FOLLOWER, copied(kit.prepared, case_folder / "v"), fresh=False)
    emulated = Follower(vehicle, silence)
    try:
        vehicle.until_positioned()
        vehicle.set_mode(GUIDED)
        vehicle.set("RNGFND1_ORIENT", 25.0)
        rest(CHECKED_S)
        said = _refused(vehicle)
        assert any("ECHO: no forward rangefinder" in text for text in said), said
        vehicle.set("RNGFND1_ORIENT", 0.0)
        vehicle.arm()
    finally:
        emulated.close()


def test_the_bench_reads_the_board_through_the_autopilot(kit: Kit, case_folder: Path) -> None:
    """`rig` over a vehicle's telemetry, the board being on SERIAL2."""
    vehicle = Vehicle(kit.binary, FOLLOWER, copied(kit.prepared, case_folder / "v"), fresh=False)
    emulated = Follower(vehicle, silence)
    try:
        # Until it has detected some heartbeats of its autopilot, the board has another system id.
        vehicle.until("forwarded its co-processor", lambda: BOARD in vehicle.heard.components)
        said = run("rig", "--port", f"tcp:{LOOPBACK}:{vehicle.usb}", "info")
        assert f"system {FOLLOWER}, component {BOARD}" in said
        assert "TRACK_RANGE   450" in said
    finally:
        emulated.close()


def _refused(vehicle: Vehicle) -> list[str]:
    """Its reasons, once it has no others than those that are to be seen."""
    said: list[str] = []

    def refuses_for_us() -> bool:
        said[:] = vehicle.try_to_arm()
        assert not vehicle.armed
        return any("ECHO" in text or "Rangefinder" in text for text in said)

    vehicle.until("refused to arm for its sonar", refuses_for_us, REFUSAL_S)
    return said
