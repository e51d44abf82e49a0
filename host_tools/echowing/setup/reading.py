"""Reads out a vehicle: requests its parameters, and listens to its messages."""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.applets import HOLD, IDENTIFYING, Applet, applets_among, identify
from echowing.errors import EchowingError
from echowing.flight.follower import GUIDED_MODE
from echowing.mavlink.messages import command_long, is_forward_rangefinder
from echowing.setup.applet import CARD_FOLDERS, applet_parameters, applet_path, files_in
from echowing.setup.checks import RC_CHANNELS, SERIAL_PORTS, ports_at_115200, signing_option
from echowing.setup.ftp import FtpClient, FtpRefusedError, NoAnswerError
from echowing.setup.ftp_format import ardupilot_crc32
from echowing.setup.readout import CardApplet, Readout, Reports
from echowing.setup.settings import LEAST_LIMITS, PROXIMITY_SENSORS, RANGEFINDERS
from echowing.setup.vehicle import AUTOPILOT, POLL_S, Heard, Name, Vehicle
from echowing.sonar_file import MAVLINK_TYPE

LISTEN_S = 3.0  # three heartbeats, 60 ranges, six of the applet's named floats
SETTLE_S = 0.5  # until our first heartbeat has opened the way for other senders
OBJECTIONS_S = 1.0  # after the answer to the command, for the texts that come with it
FILE_TIMEOUT_S = 4.0  # an autopilot without MAVFTP does not answer at all
COPROCESSOR = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER  # 191, the default COMP_ID
APPLET_STATE = "ECHO_STATE"
PREARM = "PreArm: "

_NAMES: tuple[Name, ...] = (
    ("WP_SPD", "WPNAV_SPEED"),
    ("RTL_SPEED_MS", "RTL_SPEED"),
    *(tuple(limit.names) for limit in LEAST_LIMITS),
    ("MAV_GCS_SYSID", "SYSID_MYGCS"),
    "SCR_ENABLE",
    "SCR_DIR_DISABLE",
    "SCR_HEAP_SIZE",
    "SCR_VM_I_COUNT",
    "GUID_OPTIONS",
    "GUID_TIMEOUT",
    "FS_GCS_ENABLE",
    "FS_THR_ENABLE",
    "FS_OPTIONS",
    "BATT_FS_LOW_ACT",
    "FENCE_ENABLE",
    "AVOID_ENABLE",
    "OA_TYPE",
    "ECHO_ENABLE",
)


def names_to_read(serial_port: int | None, rangefinder: int) -> list[Name]:
    """Parameters of the autopilot that a read-out needs, in every generation's names."""
    sensor = f"RNGFND{rangefinder}"
    names: list[Name] = [
        *_NAMES,
        *(f"RNGFND{number}_TYPE" for number in RANGEFINDERS),
        *(f"{sensor}_{one}" for one in ("ORIENT", "ADDR")),
        (f"{sensor}_MIN", f"{sensor}_MIN_CM"),
        (f"{sensor}_MAX", f"{sensor}_MAX_CM"),
        *(f"PRX{number}_TYPE" for number in PROXIMITY_SENSORS),
    ]
    ports: Iterable[int] = SERIAL_PORTS if serial_port is None else (serial_port,)
    return [*names, *(f"SERIAL{port}_{part}" for port in ports for part in ("PROTOCOL", "BAUD"))]


def read_parameters(
    vehicle: Vehicle, serial_port: int | None = None, rangefinder: int = 1
) -> dict[str, float]:
    """The autopilot's parameters that matter, the applet's among them.

    Raises EchowingError if it reports none at all.
    """
    found = vehicle.read(names_to_read(serial_port, rangefinder))
    if not found:
        raise EchowingError(
            f"{vehicle.name} reports but answers nothing: does the link go both ways, and is it "
            "signed (--signing-key-file)?"
        )
    others = [n for n in RANGEFINDERS if n != str(rangefinder) and found.get(f"RNGFND{n}_TYPE")]
    found |= vehicle.read([f"RNGFND{number}_ORIENT" for number in others])
    if serial_port is not None:
        found |= vehicle.read([f"SERIAL{serial_port}_OPTIONS"])
    if vehicle.signs and serial_port is not None:
        found |= vehicle.read([f"SERIAL{port}_PROTOCOL" for port in range(serial_port)])
        found |= vehicle.read([signing_option(found, serial_port)])
    if "ECHO_ENABLE" in found:
        found |= vehicle.read(IDENTIFYING)
        running = identify(found)
        rows = [] if running is None else applet_parameters(running)
        found |= vehicle.read([row.name for row in rows if row.name not in found])
    if found.get("ECHO_SWITCH", 0.0) > 0.0:
        found |= vehicle.read([f"RC{channel}_OPTION" for channel in RC_CHANNELS])
    return found


def read_out(
    vehicle: Vehicle,
    serial_port: int | None = None,
    rangefinder: int = 1,
    listen_s: float = LISTEN_S,
    applet: Applet | None = None,
    range_type: int = MAVLINK_TYPE,
) -> Readout:
    """Everything the checks need. Raises EchowingError if the vehicle is lost meanwhile.

    applet: the one that it shall run; None: the one that it runs or has on its card. range_type:
    the RNGFNDn_TYPE that it shall have.
    """
    _listen(vehicle, SETTLE_S)
    start_s = vehicle.now_s()
    heard = _listen(vehicle, listen_s)
    readout = of_messages(heard, start_s, vehicle.now_s())
    parameters = read_parameters(vehicle, serial_port, rangefinder)
    if readout.coprocessor is not None:
        told = vehicle.read(["TRACK_RANGE", "BEAM_WIDTH"], readout.coprocessor)
        readout = replace(readout, coprocessor_parameters=told)
    if serial_port is None and readout.coprocessor is not None:
        serial_port = only_port(parameters)
    applet = applet or identify(parameters) or _only_applet(vehicle) or HOLD
    version, board_id = version_and_board(vehicle)
    asked = readout.reports or vehicle.signs or range_type != MAVLINK_TYPE
    return replace(
        readout,
        applet=applet,
        board_id=board_id,
        parameters=parameters,
        serial_port=serial_port,
        rangefinder=rangefinder,
        armed=vehicle.armed,
        in_guided=vehicle.armed and vehicle.mode == GUIDED_MODE,
        applet_on_card=None if vehicle.armed else applet_on_card(vehicle, applet),
        objections=() if vehicle.armed else objections(vehicle),
        signs=vehicle.signs,
        version=version,
        range_type=range_type,
        takes_range=_takes_range(vehicle) if asked else None,
    )


def only_port(parameters: Mapping[str, float]) -> int | None:
    """The port on which a co-processor that reports must be: the only possible one."""
    ports = ports_at_115200(parameters)
    return ports[0] if len(ports) == 1 else None


def _listen(vehicle: Vehicle, listen_s: float) -> list[Heard]:
    heard: list[Heard] = []
    until_s = vehicle.now_s() + listen_s
    while (left_s := until_s - vehicle.now_s()) > 0.0:
        heard += vehicle.poll(min(POLL_S, left_s))
    return heard


def of_messages(heard: Sequence[Heard], start_s: float, end_s: float) -> Readout:
    """What follows from the messages that came unrequested between two times."""
    controllers = {
        one.message.get_srcComponent(): one.message.system_status
        for one in heard
        if _is_controller(one.message)
    }
    reporting = [one for one in heard if _is_report(one.message)]
    component = _coprocessor(controllers, {one.message.get_srcComponent() for one in reporting})
    return Readout(
        {},
        coprocessor=component,
        coprocessor_status=controllers.get(component) if component is not None else None,
        reports=_reports(reporting, start_s, end_s),
        applet_heard=any(_is_applet(one.message) for one in heard),
    )


def _coprocessor(controllers: Container[int], reporting: Iterable[int]) -> int | None:
    """Which onboard controller is ours: the one that reports a range, else the usual id."""
    candidates = [*reporting, COPROCESSOR]
    return next((one for one in candidates if one in controllers), None)


def _is_applet(message: Any) -> bool:
    if message.get_type() != "NAMED_VALUE_FLOAT" or message.get_srcComponent() != AUTOPILOT:
        return False
    return bool(message.name == APPLET_STATE)


def _is_controller(message: Any) -> bool:
    """A heartbeat of the co-processor, whichever component id it has been given."""
    if message.get_type() != "HEARTBEAT" or message.get_srcComponent() == AUTOPILOT:
        return False
    kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    return bool(message.type == kind and message.autopilot == mavlink.MAV_AUTOPILOT_INVALID)


def _is_report(message: Any) -> bool:
    return bool(message.get_type() == "DISTANCE_SENSOR" and message.get_srcComponent() != AUTOPILOT)


def _reports(heard: Sequence[Heard], start_s: float, end_s: float) -> Reports | None:
    if not heard:
        return None
    times = [start_s, *(one.time_s for one in heard), end_s]
    longest_s = max(after - before for before, after in pairwise(times))
    newest = heard[-1].message
    return Reports(len(heard), end_s - start_s, longest_s, newest.orientation, newest.id)


def applet_on_card(
    vehicle: Vehicle, applet: Applet = HOLD, folder: str | None = None
) -> CardApplet | None:
    """Compare the applet on the card with ours by its checksum; None: no answer.

    folder: of the scripts; None: the folders that ArduPilot uses.
    """
    card = FtpClient(vehicle, give_up_s=FILE_TIMEOUT_S)
    try:
        place, there = _applets_on_card(card, folder)
        if applet not in there:
            return CardApplet.OTHER if there else CardApplet.NONE
        if len(there) > 1:
            return CardApplet.SEVERAL
        found = card.checksum(f"{place}/{applet.file}")
    except (NoAnswerError, FtpRefusedError):
        return None
    if found is None:
        return None
    ours = ardupilot_crc32(applet_path(applet).read_bytes())
    return CardApplet.OURS if found == ours else CardApplet.ANOTHER


def _applets_on_card(card: FtpClient, folder: str | None) -> tuple[str, list[Applet]]:
    """The folder of scripts that has applets, and which. Raises FtpRefusedError."""
    for place in CARD_FOLDERS if folder is None else (folder,):
        try:
            there = applets_among(files_in(card, place))
        except FtpRefusedError as refusal:
            if not refusal.not_there:
                raise
            continue
        if there:
            return place, there
    return "", []


def _only_applet(vehicle: Vehicle) -> Applet | None:
    """The applet on the card where there is one alone."""
    if vehicle.armed:
        return None
    try:
        _, there = _applets_on_card(FtpClient(vehicle, give_up_s=FILE_TIMEOUT_S), None)
    except (NoAnswerError, FtpRefusedError):
        return None
    return there[0] if len(there) == 1 else None


def objections(vehicle: Vehicle) -> tuple[str, ...]:
    """Why the autopilot would not arm now, in its own words; empty where it would."""
    vehicle.texts.clear()
    result = vehicle.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        return ()
    _listen(vehicle, OBJECTIONS_S)
    told = (text.removeprefix(PREARM) for text in vehicle.texts if text.startswith(PREARM))
    return tuple(dict.fromkeys(told))


def version_and_board(vehicle: Vehicle) -> tuple[tuple[int, int] | None, int | None]:
    """What AUTOPILOT_VERSION tells; the board's id as GCS_Common.cpp puts it there."""
    wanted = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    message = _requested(vehicle, wanted, lambda m: True)
    if message is None:
        return None, None
    version = message.flight_sw_version >> 24 & 0xFF, message.flight_sw_version >> 16 & 0xFF
    return version, message.board_version >> 16


def _takes_range(vehicle: Vehicle) -> bool:
    """Whether the autopilot reports a forward range of its own: only then it has one."""
    wanted = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
    return _requested(vehicle, wanted, is_forward_rangefinder) is not None


def _requested(vehicle: Vehicle, message_id: int, fits: Callable[[Any], bool]) -> Any | None:
    """A message of the autopilot, requested a few times; None if it does not come."""
    ask = command_long(vehicle.system_id, mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)
    for _ in range(3):
        vehicle.send(ask)
        found = vehicle.until(
            lambda m: m.get_msgId() == message_id and m.get_srcComponent() == AUTOPILOT and fits(m),
            1.0,
        )
        if found is not None:
            return found
    return None
