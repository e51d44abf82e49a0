"""Is this vehicle ready for Echowing? A table of small pure judgements over one read-out.

Each looks at one thing and says whether it is fine, wrong, the pilot's to decide, or cannot be
determined; and if it is wrong, why and how to fix it. The expected values are in `settings`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.applets import HOLD, SPEED, Version, identify, is_outdated
from echowing.flight.by_sonar import BySonar, applet_by_sonar, board_by_sonar
from echowing.flight.leader_speed import MOST_LEADER_MPS
from echowing.mavlink.messages import TOOL_SYSTEM_ID
from echowing.setup.boards import Board
from echowing.setup.readout import CardApplet, Readout, Role
from echowing.setup.settings import (
    BAUD_115200,
    FORWARD,
    HEAP,
    MAVLINK2,
    PROXIMITY_MAVLINK,
    PROXIMITY_RANGEFINDER,
    PROXIMITY_SENSORS,
    RANGEFINDERS,
    Setting,
    settings_for,
)

# AP_RangeFinder_MAVLink.cpp: older data is dropped.
RANGEFINDER_TIMEOUT_S = 0.5
SLOWEST_REPORT_HZ = 5.0  # firmware/README.md, REPORT_RATE's least
SERIAL_PORTS = range(1, 10)
RC_CHANNELS = range(1, 17)
MAVLINK_PROTOCOLS = (1.0, MAVLINK2)
MAVLINK_HIGH_LATENCY = 43.0  # SERIALn_PROTOCOL: a MAVLink port too, where MAVn_* are counted
NOT_SIGNED = 1  # MAVn_OPTIONS bit 0: this port neither signs nor wants signatures
# With a speed parameter under this the vehicle returns home at walking pace.
SLOW_MPS = 1.0
MEMORY = "memory for scripts"
MEASURE = "see whether the applet loads; SCR_DEBUG_OPTS 2 shows what it takes (Lua: Time … Mem …)"
OTHER_AUTOPILOT = "take an autopilot with an F7 of 512 KiB or an H7 (lua/echowing.md)"

APPLY = "echowing setup apply"
UPLOAD = f"echowing setup lua --vehicle …, or {APPLY}"
SCRIPTING = "Scripting:"  # AP_Arming.cpp puts it before a script's error


class Verdict(Enum):
    """The result of a check."""

    FINE = "fine"
    WRONG = "wrong"
    YOURS = "yours"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """One item. fix: what to type or to do; empty: nothing."""

    about: str
    verdict: Verdict
    found: str
    why: str = ""
    fix: str = ""


Check = Callable[[Readout], Iterable[Finding]]


def examine(readout: Readout, role: Role = Role.FOLLOWER) -> list[Finding]:
    """All findings for a vehicle in this role, in the order of the table."""
    return [finding for check in CHECKS[role] for finding in check(readout)]


def exit_code(findings: Iterable[Finding]) -> int:
    """0: nothing wrong; 1: something is wrong; 2: something could not be determined."""
    verdicts = {finding.verdict for finding in findings}
    if Verdict.WRONG in verdicts:
        return 1
    return 2 if Verdict.UNKNOWN in verdicts else 0


def judge(setting: Setting, readout: Readout) -> Finding | None:
    """Judge one setting by the read-out; None: no finding."""
    value = readout.parameters.get(setting.name)
    if value is None and setting.optional:
        return None
    if value is None:
        return Finding(setting.name, Verdict.UNKNOWN, "not reported", setting.why, _hidden(setting))
    if setting.fits(value):
        return Finding(setting.name, Verdict.FINE, f"{value:g}", setting.why)
    if setting.spared(value):
        return Finding(
            setting.name,
            Verdict.WRONG,
            f"{value:g}: another sensor is set up there",
            setting.why,
            "use the next one: echowing setup … --rangefinder 2",
        )
    fix = f"param set {setting.name} {setting.fixed(value):g}; or {APPLY}"
    if setting.restart:
        fix += "; then restart the autopilot"
    return Finding(setting.name, Verdict.WRONG, f"{value:g}", setting.why, fix)


def _hidden(setting: Setting) -> str:
    if setting.name.startswith("SERIAL"):
        return "does this autopilot have such a port?"
    if setting.name == "SCR_ENABLE":
        return "this firmware has no scripting: small boards need a custom build"
    if setting.name.startswith("SCR_"):
        return "shown once SCR_ENABLE is 1 and the autopilot restarted"
    if setting.name.startswith("RNGFND") and not setting.name.endswith("_TYPE"):
        return "shown once the rangefinder's TYPE is set and the autopilot restarted"
    return "is this ArduCopter 4.5 or later?"


def _settings(readout: Readout) -> Iterator[Finding]:
    for setting in settings_for(readout):
        finding = judge(setting, readout)
        if finding is not None:
            yield finding


# ---- the co-processor and its range ------------------------------------------------------------


def _coprocessor(readout: Readout) -> Iterator[Finding]:
    if readout.fixed:
        return
    if readout.coprocessor is None and readout.signs and readout.takes_range:
        found = "the autopilot has its range; a signed link refuses its own, unsigned messages"
        yield Finding("co-processor", Verdict.FINE, found)
    elif readout.coprocessor is None and _is_silenced(readout):
        yield Finding(
            "co-processor",
            Verdict.WRONG,
            "not detected, and signing is on",
            "the autopilot drops what is not signed, and the co-processor does not sign: no "
            "heartbeat and no range of it comes in",
            _how_to_exempt(readout),
        )
    elif readout.coprocessor is None:
        yield Finding(
            "co-processor",
            Verdict.WRONG,
            "not detected",
            "no heartbeat of an onboard controller comes through the autopilot",
            _how_to_be_heard(readout),
        )
    elif readout.coprocessor_status == mavlink.MAV_STATE_CRITICAL:
        yield Finding(
            "co-processor",
            Verdict.WRONG,
            f"component {readout.coprocessor} reports a fault",
            "its sonar does not answer",
            "look at the sonar's supply, SDA, SCL and SONAR_ADDR (firmware/README.md, step 2)",
        )
    else:
        where = "" if readout.serial_port is None else f" on SERIAL{readout.serial_port}"
        found = f"component {readout.coprocessor} detected{where}"
        yield Finding("co-processor", Verdict.FINE, found)


def signing_option(parameters: Mapping[str, float], serial_port: int) -> str:
    """The MAVn_OPTIONS of a serial port, from 4.7 on: n counts the MAVLink ports from SERIAL0."""
    protocols = (*MAVLINK_PROTOCOLS, MAVLINK_HIGH_LATENCY)
    before = [parameters.get(f"SERIAL{number}_PROTOCOL") for number in range(serial_port)]
    return f"MAV{1 + sum(protocol in protocols for protocol in before)}_OPTIONS"


def _is_silenced(readout: Readout) -> bool:
    """Whether the autopilot drops unsigned messages on the co-processor's port."""
    if not readout.signs or readout.serial_port is None:
        return readout.signs
    option = signing_option(readout.parameters, readout.serial_port)
    return not int(readout.parameters.get(option, 0.0)) & NOT_SIGNED


def _how_to_exempt(readout: Readout) -> str:
    if readout.serial_port is None:
        return "say where the co-processor is wired, as --serial 2: then its port is named here"
    option = signing_option(readout.parameters, readout.serial_port)
    if option not in readout:
        return (
            "up to ArduCopter 4.6 only the USB port takes unsigned messages: update to 4.7 or "
            "later, or fly without signing (host_tools/SETUP.md, Signing)"
        )
    value = int(readout.parameters[option]) | NOT_SIGNED
    return f"param set {option} {value} (signing off on this wire only), and restart the autopilot"


def _how_to_be_heard(readout: Readout) -> str:
    if readout.serial_port is not None:
        return (
            f"set SERIAL{readout.serial_port} as said here, restart, and look at the wires: TX to "
            "RX both ways, and power"
        )
    ports = ", ".join(f"SERIAL{number}" for number in ports_at_115200(readout.parameters)) or "none"
    return (
        f"say where it is wired, as --serial 2 (MAVLink at 115200 baud is now on: {ports}); then "
        f"{APPLY} --serial 2, restart, and look at the wires"
    )


def ports_at_115200(parameters: Mapping[str, float]) -> list[int]:
    """The serial ports on which a co-processor can report, as they are set."""
    return [
        number
        for number in SERIAL_PORTS
        if parameters.get(f"SERIAL{number}_PROTOCOL") in MAVLINK_PROTOCOLS
        and parameters.get(f"SERIAL{number}_BAUD") in BAUD_115200
    ]


def _reports(readout: Readout) -> Iterator[Finding]:
    about, reports = "DISTANCE_SENSOR", readout.reports
    if readout.coprocessor is None or readout.fixed:
        return
    if reports is None:
        yield Finding(
            about,
            Verdict.WRONG,
            "none received",
            "the co-processor is there but reports no range",
            "look at its LED and its texts: the sonar may not answer (firmware/README.md)",
        )
        return
    found = f"{reports.rate_hz:.1f} per second, longest gap {reports.longest_gap_s:.2f} s"
    steady = reports.longest_gap_s < RANGEFINDER_TIMEOUT_S
    if reports.orientation != FORWARD:
        yield Finding(
            about,
            Verdict.WRONG,
            f"orientation {reports.orientation}",
            "the autopilot ignores a range of another orientation than RNGFND's",
            "does another device send it?",
        )
    elif steady and reports.rate_hz >= SLOWEST_REPORT_HZ:
        yield Finding(about, Verdict.FINE, found)
    else:
        yield Finding(
            about,
            Verdict.WRONG,
            found,
            f"the autopilot drops a range older than {RANGEFINDER_TIMEOUT_S:g} s; over a slow "
            "radio this link may lose them",
            "check again over USB; then REPORT_RATE and the wire",
        )


def _taken(readout: Readout) -> Iterator[Finding]:
    """Whether the autopilot uses the range, which is what all this is for."""
    about = "range in the autopilot"
    if readout.takes_range:
        yield Finding(about, Verdict.FINE, "it reports a forward range itself")
    elif readout.takes_range is not None and readout.fixed:
        yield Finding(
            about,
            Verdict.WRONG,
            "not there",
            "the autopilot's own driver has no data of the sensor",
            f"set RNGFND{readout.rangefinder}_* as the sensor's page in ArduPilot's documentation "
            "says, look at its wires, and restart the autopilot",
        )
    elif readout.takes_range is not None and readout.reports is not None:
        yield Finding(
            about,
            Verdict.WRONG,
            "not there",
            "the co-processor's range arrives but the autopilot does not use it",
            f"set RNGFND{readout.rangefinder}_* as said here, and restart the autopilot",
        )


def _second_sensor(readout: Readout) -> Iterator[Finding]:
    """Another rangefinder that looks forward: applet and tool might take it for the sonar."""
    harmless = not readout.fixed and readout.applet == HOLD
    for number in RANGEFINDERS:
        name = f"RNGFND{number}"
        kind = readout.parameters.get(f"{name}_TYPE")
        if number == str(readout.rangefinder) or not kind:
            continue
        if readout.parameters.get(f"{name}_ORIENT") == FORWARD:
            yield Finding(
                f"{name}_ORIENT",
                Verdict.YOURS if harmless else Verdict.WRONG,
                f"0: a second forward sensor, of type {kind:g}",
                f"RNGFND{readout.rangefinder} is meant; what this one reads may be taken for the "
                + ("sonar's where that is silent" if harmless else "leader's distance"),
                f"param set {name}_TYPE 0, or {name}_ORIENT to where it looks; or, if it is the "
                f"one: --rangefinder {number}, and --sonar with its file",
            )


def _sonars_limits(readout: Readout) -> Iterator[Finding]:
    """What applet and co-processor are told of the sonar, beside what its file says."""
    for name, one in applet_by_sonar(readout.sonar).items():
        yield from _as_in_file(name, readout.parameters, one)
    told = {} if readout.fixed else readout.coprocessor_parameters
    for name, one in board_by_sonar(readout.sonar).items():
        yield from _as_in_file(name, told, one, f" of component {readout.coprocessor}")


def _as_in_file(
    name: str, told: Mapping[str, float], by_file: BySonar, whose: str = ""
) -> Iterator[Finding]:
    """A parameter beside the sonar file's value."""
    value = told.get(name)
    if value is None:
        return
    if by_file.fits(value):
        if whose:  # the applet's own are listed among the settings
            yield Finding(name, Verdict.FINE, f"{value:g}", "as the sonar file says")
        return
    fix = f"param set {name} {by_file.value:g}{whose}, or give the file of its sonar: --sonar"
    fix += "" if whose else f" ({APPLY} writes it then)"
    why = f"the sonar file says {by_file.value:g}; {by_file.why}"
    yield Finding(name, Verdict.YOURS, f"{value:g}", why, fix)


# ---- the applet and the speed ------------------------------------------------------------------


def _applet(readout: Readout) -> Iterator[Finding]:
    enabled = readout.parameters.get("ECHO_ENABLE")
    switched = readout.parameters.get("ECHO_SWITCH", 0.0) > 0.0
    error = next((one for one in readout.objections if SCRIPTING in one), None)
    if error is not None:
        yield Finding(
            "applet",
            Verdict.WRONG,
            error,
            "a script has failed, in the autopilot's own words; it refuses to arm",
            "if it names echowing.lua: echowing setup lua --vehicle …; if another script: "
            f"remove that from the card; if memory: {APPLY} sets what the board can give; then "
            "restart the autopilot",
        )
    elif enabled is None:
        yield Finding("applet", Verdict.WRONG, *_why_absent(readout))
    elif is_outdated(readout.parameters):
        yield Finding(
            "applet",
            Verdict.WRONG,
            "its parameters are those of another version",
            "tools and applet must have the same version",
            f"update it: {UPLOAD}; then restart the autopilot",
        )
    elif readout.applet_heard:
        yield Finding("applet", Verdict.FINE, "in control")
    elif readout.in_guided and enabled and not switched:
        yield Finding(
            "applet",
            Verdict.WRONG,
            "silent in Guided",
            "its parameters are there, but it sends no ECHO_STATE: it has stopped",
            "land; look for its last message, then restart the autopilot",
        )
    else:
        yield Finding("applet", Verdict.FINE, "loaded; it reports only while in control, in Guided")


def _why_absent(readout: Readout) -> tuple[str, str, str]:
    """What was found, why, and what to do if there are no ECHO_ parameters."""
    if readout.parameters.get("SCR_ENABLE") == 0.0:
        why, fix = "scripts run only while SCR_ENABLE is 1", f"param set SCR_ENABLE 1; or {APPLY}"
        return "does not run: scripting is off", why, f"{fix}; then restart the autopilot"
    if readout.applet_on_card is CardApplet.NONE:
        return "not on the card", "without the applet the sonar's distance has no effect", UPLOAD
    if readout.applet_on_card is None:
        why = "the card cannot be read, and the autopilot reports no error"
        return "no ECHO_ parameters", why, f"{UPLOAD}; then restart the autopilot"
    why = "the autopilot reports no error; it loads scripts when it starts"
    return "on the card, but it does not run", why, "restart the autopilot"


def _applet_file(readout: Readout) -> Iterator[Finding]:
    if readout.applet_on_card is CardApplet.OURS:
        yield Finding("applet on the card", Verdict.FINE, "the one of this package")
    elif readout.applet_on_card is CardApplet.ANOTHER:
        yield Finding(
            "applet on the card",
            Verdict.WRONG,
            "another version than this package's",
            "tools and applet must have the same version",
            UPLOAD,
        )
    elif readout.applet_on_card in (CardApplet.OTHER, CardApplet.SEVERAL):
        several = readout.applet_on_card is CardApplet.SEVERAL
        yield Finding(
            "applet on the card",
            Verdict.WRONG,
            "two applets" if several else f"another one than {readout.applet.file}",
            "a vehicle runs one applet: they use the same parameters",
            f"{APPLY} --applet {readout.applet.name} --replace takes the other one off the card",
        )


def memory(readout: Readout) -> Finding:
    """Whether the board has memory enough for the applet."""
    board, need = readout.board, readout.applet.needs_bytes(readout.version)
    runs = identify(readout.parameters) == readout.applet
    needs = f"{readout.applet.file} needs {_kib(need)}"
    value = readout.parameters.get(HEAP)
    if board is None:
        return _memory_of_unknown(readout, runs=runs, needs=needs)
    if runs or board.heap_bytes >= need:
        about = f"{board.name} ({board.processor}) gives {_kib(board.heap_bytes)}; {needs}"
        return Finding(MEMORY, Verdict.FINE, about)
    if value is not None and need <= value <= board.most_heap_bytes:
        return Finding(MEMORY, Verdict.FINE, f"{HEAP} {value:g} is yours; {needs}")
    gives = "no scripting" if board.heap_bytes == 0 else f"{_kib(board.heap_bytes)} for scripts"
    return Finding(
        MEMORY,
        Verdict.WRONG,
        f"{board.name} ({board.processor}) has {gives}",
        f"{needs}: it does not load",
        _what_fits(board, readout.version),
    )


def _what_fits(board: Board, version: Version | None) -> str:
    fitting = []
    for applet in (SPEED, HOLD):
        since = applet.fits_since(board.heap_bytes)
        if since is not None:
            too_old = version is not None and version < since
            later = " with ArduCopter {}.{} or later".format(*since) if too_old else ""
            fitting.append(f"--applet {applet.name} fits there{later}")
    return "; ".join(fitting) or OTHER_AUTOPILOT


def _memory_of_unknown(readout: Readout, *, runs: bool, needs: str) -> Finding:
    which = "its board" if readout.board_id is None else f"board {readout.board_id}"
    value, need = readout.parameters.get(HEAP), readout.applet.needs_bytes(readout.version)
    if runs:
        return Finding(MEMORY, Verdict.FINE, f"{which} is not known; {readout.applet.file} runs")
    why = f"{needs}; {which} is not known, so how much it can give is not known either"
    if value is None:
        return Finding(MEMORY, Verdict.UNKNOWN, f"{HEAP} not reported", why, MEASURE)
    if value < need:
        fix = f"try {HEAP} {need} and restart; {MEASURE}"
        return Finding(MEMORY, Verdict.WRONG, f"{HEAP} {value:g}", why, fix)
    return Finding(MEMORY, Verdict.UNKNOWN, f"{HEAP} {value:g}", why, MEASURE)


def _kib(count: int) -> str:
    return f"{count / 1024:.0f} KiB"


def _memory(readout: Readout) -> Iterator[Finding]:
    yield memory(readout)


def _switch(readout: Readout) -> Iterator[Finding]:
    """Without a channel for its switch the applet never acts, and reports nothing."""
    option = readout.parameters.get("ECHO_SWITCH", 0.0)
    if option == 0.0:
        return
    channels = [n for n in RC_CHANNELS if readout.parameters.get(f"RC{n}_OPTION") == option]
    if channels:
        yield Finding("switch", Verdict.FINE, f"channel {channels[0]}, option {option:g}")
        return
    yield Finding(
        "switch",
        Verdict.WRONG,
        f"ECHO_SWITCH {option:g}, and no channel has this option",
        "the applet waits for a switch that does not exist",
        f"param set RC7_OPTION {option:g}, or the channel of your switch; or ECHO_SWITCH 0",
    )


def _speed(readout: Readout) -> Iterator[Finding]:
    speed = readout.first("WP_SPD", "WPNAV_SPEED")
    if speed is None:
        yield Finding(
            "speed parameter",
            Verdict.UNKNOWN,
            "neither WP_SPD nor WPNAV_SPEED",
            "the applet sets one of them",
            "is this ArduCopter 4.5 or later?",
        )
        return
    name, value = speed
    mirror = readout.parameters.get("ECHO_MIRROR", 0.0)
    speed_mps = value if name == "WP_SPD" else value / 100.0
    if mirror > 0.0 and not readout.armed:
        yield Finding(
            name,
            Verdict.WRONG,
            f"{value:g}, yours was {mirror:g} (ECHO_MIRROR)",
            "the applet stopped while in control and has not restored your speed",
            "restart the autopilot or its scripts: the applet then restores it",
        )
    elif mirror == 0.0 and speed_mps < SLOW_MPS:
        yield Finding(
            name,
            Verdict.YOURS,
            f"{value:g}",
            "every mission flies this slowly; is it a limit that the applet has left?",
            f"param set {name} {10.0 if name == 'WP_SPD' else 1000.0:g} is ArduCopter's own",
        )
    else:
        yield Finding(name, Verdict.FINE, f"{value:g}")


# ---- what the pilot decides --------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Choice:
    """A parameter that is only reported and never written, because it is the pilot's to decide."""

    names: tuple[str, ...]
    doubtful: Callable[[float], bool]
    why: str
    fix: str


_CHOICES = (
    _Choice(
        ("FS_GCS_ENABLE",),
        lambda v: v == 0.0,
        "the vehicle does not react when the ground station fails",
        "param set FS_GCS_ENABLE 1 (return home), or as you fly",
    ),
    _Choice(
        ("MAV_GCS_SYSID", "SYSID_MYGCS"),
        lambda v: v == TOOL_SYSTEM_ID,
        "echowing itself sends heartbeats with this id, so a failed ground station would not "
        "be detected",
        "set it to your ground station's id, usually 255",
    ),
    _Choice(
        ("FS_THR_ENABLE",),
        lambda v: v == 0.0,
        "nothing happens when the transmitter is lost",
        "param set FS_THR_ENABLE 1 (return home), or as you fly",
    ),
    _Choice(
        ("FS_OPTIONS",),
        lambda v: bool(int(v) & 4),
        "in Guided the vehicle ignores the loss of the transmitter (bit 2)",
        "clear bit 2",
    ),
    _Choice(
        ("BATT_FS_LOW_ACT",),
        lambda v: v == 0.0,
        "nothing happens when the battery is low",
        "param set BATT_FS_LOW_ACT 2 (return home) or 1 (land)",
    ),
    _Choice(
        ("FENCE_ENABLE",),
        lambda v: v == 0.0,
        "no fence stops a vehicle that flies away; a fence does not keep vehicles apart",
        "param set FENCE_ENABLE 1 after setting its radius and altitude",
    ),
)
_APPLET_CHOICES = (
    _Choice(
        ("ECHO_STREAM_T",),
        lambda v: v == 0.0,
        "the applet's watchdog is off: if the ground tool fails, the vehicle flies on to its "
        "last point",
        "param set ECHO_STREAM_T 1",
    ),
    _Choice(
        ("ECHO_ARM_CHK",),
        lambda v: v == 0.0,
        "it arms without a forward rangefinder",
        "param set ECHO_ARM_CHK 1",
    ),
)


def _choices(readout: Readout) -> Iterator[Finding]:
    for choice in _CHOICES:
        named = readout.first(*choice.names)
        if named is not None:
            name, value = named
            yield _doubt(choice, name, value) or Finding(name, Verdict.FINE, f"{value:g}")


def _applet_choices(readout: Readout) -> Iterator[Finding]:
    """Without doubts these are judged as settings."""
    for choice in _APPLET_CHOICES:
        named = readout.first(*choice.names)
        doubt = None if named is None else _doubt(choice, *named)
        if doubt is not None:
            yield doubt


def _doubt(choice: _Choice, name: str, value: float) -> Finding | None:
    if not choice.doubtful(value):
        return None
    return Finding(name, Verdict.YOURS, f"{value:g}", choice.why, choice.fix)


def _avoidance(readout: Readout) -> Iterator[Finding]:
    """A proximity sensor of its own detects the leader too; one with our range is always wrong."""
    sensors = [f"PRX{n}_TYPE" for n in PROXIMITY_SENSORS]
    harmless = (0.0, PROXIMITY_MAVLINK, PROXIMITY_RANGEFINDER)
    present = [name for name in sensors if readout.parameters.get(name, 0.0) not in harmless]
    avoids = int(readout.parameters.get("AVOID_ENABLE", 0.0)) & 2
    plans = readout.parameters.get("OA_TYPE", 0.0) > 0.0
    if present and (avoids or plans):
        yield Finding(
            "AVOID_ENABLE" if avoids else "OA_TYPE",
            Verdict.YOURS,
            f"avoidance by {present[0]}",
            "it avoids what it detects, and it detects the leader",
            "param set AVOID_ENABLE 1 (fence only) and OA_TYPE 0 for formation flight",
        )


def _arming(readout: Readout) -> Iterator[Finding]:
    """Other reasons for which the autopilot would refuse to arm; indoors this is normal."""
    for reason in readout.objections:
        if SCRIPTING not in reason:
            yield Finding(
                "arming",
                Verdict.YOURS,
                reason,
                "the autopilot would not arm now, in its own words",
                "this is normal indoors, without GPS; otherwise fix it before the flight",
            )


def _leaders_speed(readout: Readout) -> Iterator[Finding]:
    """As `_speed`; a mission that says no other speed is flown at this one."""
    for one in _speed(readout):
        metres = 1.0 if one.about == "WP_SPD" else 100.0
        speed_mps = readout.parameters.get(one.about, 0.0) / metres
        if one.verdict is not Verdict.FINE or speed_mps <= MOST_LEADER_MPS:
            yield one
            continue
        yield Finding(
            one.about,
            Verdict.YOURS,
            one.found,
            f"missions fly at {speed_mps:g} m/s; followers keep their distance up to "
            f"{MOST_LEADER_MPS:g} m/s",
            f"param set {one.about} {MOST_LEADER_MPS * metres:g}, or less; or DO_CHANGE_SPEED in "
            "the mission",
        )


def _leaders_applet(readout: Readout) -> Iterator[Finding]:
    """An enabled applet on a leader would take its speed in Guided."""
    if readout.parameters.get("ECHO_ENABLE", 0.0):
        yield Finding(
            "ECHO_ENABLE",
            Verdict.YOURS,
            "1",
            "set up as a follower: in Guided its applet changes its speed",
            "param set ECHO_ENABLE 0 while it leads",
        )


CHECKS: Mapping[Role, tuple[Check, ...]] = {
    Role.FOLLOWER: (
        _coprocessor,
        _reports,
        _taken,
        _second_sensor,
        _applet,
        _applet_file,
        _memory,
        _arming,
        _switch,
        _speed,
        _sonars_limits,
        _settings,
        _avoidance,
        _choices,
        _applet_choices,
    ),
    # A leader flies with its own ground station; it needs none of the follower's equipment.
    Role.LEADER: (_arming, _leaders_speed, _leaders_applet, _choices),
}
