"""Restarts the autopilot, or its scripts, and waits until the vehicle is there again."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.setup.checks import SCRIPTING
from echowing.setup.reading import objections
from echowing.setup.vehicle import POLL_S, Vehicle

# The autopilot goes on for a moment after it has acknowledged the command (GCS_Common.cpp,
# handle_preflight_reboot): what arrives in this time is from before the restart.
GOING_DOWN_S = 3.0
# A board with a bootloader and many sensors takes 10 to 20 s, and so does a radio after it.
RESTART_TIMEOUT_S = 60.0
APPLET_TIMEOUT_S = 20.0
_STARTING = (mavlink.MAV_STATE_UNINIT, mavlink.MAV_STATE_BOOT)


def restart_autopilot(vehicle: Vehicle) -> bool:
    """Restart it and wait until it reports again; False: it does not restart by command.

    Raises EchowingError if it does not report again.
    """
    result = vehicle.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        return False
    start_s = vehicle.now_s()
    vehicle.forget()
    while (gone_s := vehicle.now_s() - start_s) < RESTART_TIMEOUT_S:
        heard = vehicle.poll(POLL_S, silence_s=RESTART_TIMEOUT_S)
        if gone_s >= GOING_DOWN_S and any(_is_up(one.message) for one in heard):
            return True
        if gone_s < GOING_DOWN_S:
            vehicle.forget()
    raise EchowingError(
        f"{vehicle.name} does not report {RESTART_TIMEOUT_S:g} s after its restart; check it "
        "and the link"
    )


def _is_up(message: object) -> bool:
    """Whether it is an autopilot's heartbeat after its start."""
    kind = getattr(message, "get_type", str)()
    if kind != "HEARTBEAT" or getattr(message, "autopilot", 0) == mavlink.MAV_AUTOPILOT_INVALID:
        return False
    return getattr(message, "system_status", 0) not in _STARTING


def restart_scripts(vehicle: Vehicle) -> bool:
    """Have the card's scripts loaded again; False: it does not accept the command."""
    vehicle.texts.clear()
    result = vehicle.command_int(mavlink.MAV_CMD_SCRIPTING, mavlink.SCRIPTING_CMD_STOP_AND_RESTART)
    return bool(result == mavlink.MAV_RESULT_ACCEPTED)


def until_applet_runs(vehicle: Vehicle) -> bool:
    """Wait for the applet's parameters; False: they do not come, or a script has failed."""
    until_s = vehicle.now_s() + APPLET_TIMEOUT_S
    while vehicle.now_s() < until_s:
        if vehicle.read(["ECHO_ENABLE"]):
            return True
        if scripting_error(objections(vehicle)):
            return False
    return False


def scripting_error(told: Sequence[str]) -> str:
    """The autopilot's message about a failed script; empty: none."""
    return next((text for text in told if SCRIPTING in text), "")
