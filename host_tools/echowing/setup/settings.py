"""The autopilot's parameters that Echowing needs, the value of each, and why: one table.

`check` judges by it and `apply` writes by it. Fail-safes and fence are not in it, they are the
pilot's (see `checks`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from echowing.applets import FORMAT, identify
from echowing.flight.by_sonar import TOLERANCE, BySonar, applet_by_sonar
from echowing.mavlink.vehicle_limits import ACCELERATION, JERK, LEAN, VehicleLimit
from echowing.setup.applet import AppletParameter, applet_parameters
from echowing.setup.readout import Readout
from echowing.sonar_file import MAVLINK_TYPE

# ---- the expected values, and their sources ---------------------------------------------------

MAVLINK2 = 2.0  # SERIALn_PROTOCOL
# firmware/echowing/src/board/arduino_board.cpp, kBaud; ArduPilot takes 115 and 115200 for it.
BAUD_115200 = (115.0, 115_200.0)
NOT_FORWARDED = (
    1024  # SERIALn_OPTIONS bit 10: MAVLink is not passed on between this port and others
)
RANGEFINDER_NONE, RANGEFINDER_MAVLINK = 0.0, float(MAVLINK_TYPE)  # RNGFNDn_TYPE
FORWARD = 0.0  # RNGFNDn_ORIENT
RANGEFINDERS = "123456789A"  # RNGFNDn_*: the tenth is RNGFNDA
# The MaxSonar's span (its data sheet): below 0.2 m it reads 0.2, beyond 7.65 m nothing.
RANGE_MIN_M, RANGE_MAX_M = 0.2, 7.65
# PRXn_TYPE: one that takes DISTANCE_SENSOR for itself, and one that takes the rangefinders for
# obstacles, the leader among them.
PROXIMITY_MAVLINK, PROXIMITY_RANGEFINDER = 2.0, 4.0
PROXIMITY_SENSORS = range(1, 6)
SCRIPTS_NOT_LOADED = 2  # SCR_DIR_DISABLE bit 1: not from the card
HEAP = "SCR_HEAP_SIZE"
INSTRUCTIONS = 10_000.0  # SCR_VM_I_COUNT's default; an update takes a tenth of it
RTL_SPEED_MPS = 5.0  # WP_SPD's half: what the applet's doc suggests
# What the separation guard needs to fly back before a leader that reverses at 2 m/s arrives.
# With ArduCopter's own 2.5 m/s^2 and 5 m/s^3 the follower begins to move when it is too late.
# Against 6 m/s of wind a copter leans by 16 degrees to hover: of ArduCopter's own 30 degrees too
# little is left for 5 m/s^2, and the slot opens beyond the sonar's reach (`flight/wind.py`).
LEAST_LIMITS = {ACCELERATION: 5.0, JERK: 20.0, LEAN: 45.0}
GUIDED_BY_WAYPOINTS = 64  # GUID_OPTIONS bit 6
GUIDED_TIMEOUT_S, LONGEST_GUIDED_TIMEOUT_S = 3.0, 5.0  # GUID_TIMEOUT: its default, its range's end


@dataclass(frozen=True, slots=True)
class Setting:
    """A required parameter.

    fits: whether a value is right; fixed: what to write instead of a wrong one. optional: the
    vehicle does not need this parameter. restart: it takes effect from the next start on. spared:
    a value that is never overwritten, because something else of the pilot's depends on it.
    """

    name: str
    fits: Callable[[float], bool]
    fixed: Callable[[float], float]
    why: str
    optional: bool = False
    restart: bool = False
    spared: Callable[[float], bool] = lambda value: False


def same(value: float, wanted: float) -> bool:
    """Whether two parameter values are the same for a 32-bit float."""
    return abs(value - wanted) <= TOLERANCE * max(1.0, abs(wanted))


def settings_for(readout: Readout) -> list[Setting]:
    """The settings of this vehicle: in its generation's names and units, for its wiring."""
    settings = [
        *_scripting(readout),
        *_guided(),
        *_limits(readout),
        *_proximity(),
        *_rangefinder(readout),
        *_applet(readout),
    ]
    if readout.serial_port is not None and not readout.fixed:
        settings = [*_serial(readout.serial_port), *settings]
    return settings


def _exactly(name: str, wanted: float, why: str, *, restart: bool = False) -> Setting:
    return Setting(name, lambda v: same(v, wanted), lambda v: wanted, why, restart=restart)


def _bit_off(name: str, bit: int, why: str, *, restart: bool = False) -> Setting:
    return Setting(
        name,
        lambda v: not int(v) & bit,
        lambda v: float(int(v) & ~bit),
        why,
        optional=True,
        restart=restart,
    )


def _serial(port: int) -> Iterator[Setting]:
    name = f"SERIAL{port}"
    yield _exactly(f"{name}_PROTOCOL", MAVLINK2, "the co-processor speaks MAVLink 2", restart=True)
    yield Setting(
        f"{name}_BAUD",
        lambda v: v in BAUD_115200,
        lambda v: BAUD_115200[0],
        "the co-processor speaks at 115200 baud",
        restart=True,
    )
    yield _bit_off(
        f"{name}_OPTIONS",
        NOT_FORWARDED,
        "the autopilot must pass the co-processor's messages on to the ground",
        restart=True,
    )


def _rangefinder(readout: Readout) -> Iterator[Setting]:
    name, kind = f"RNGFND{readout.rangefinder}", float(readout.range_type)
    reads = "the autopilot reads it itself" if readout.fixed else "the range comes by MAVLink"
    yield Setting(
        f"{name}_TYPE",
        lambda v: v == kind,
        lambda v: kind,
        f"{reads} ({kind:g})",
        restart=True,
        spared=lambda v: v not in (RANGEFINDER_NONE, RANGEFINDER_MAVLINK, kind),
    )
    looks = "sensor" if readout.fixed else "co-processor"
    yield Setting(
        f"{name}_ORIENT",
        lambda v: v == FORWARD,
        lambda v: FORWARD,
        f"the {looks} looks forward (0); a range of another orientation is ignored",
    )
    if readout.fixed:
        return  # its span, and what its driver needs, are the sensor's
    yield from _span(f"{name}_MIN", RANGE_MIN_M, readout, "the sonar's nearest range")
    yield from _span(
        f"{name}_MAX",
        RANGE_MAX_M,
        readout,
        "the sonar's farthest range; anything beyond is no range",
    )
    known = None if readout.reports is None else readout.reports.sensor_id
    yield Setting(
        f"{name}_ADDR",
        lambda v: v in (0.0, known),
        lambda v: 0.0,
        "from 4.8 on another value discards the range without a message",
        optional=True,
    )


def _span(name: str, wanted_m: float, readout: Readout, why: str) -> Iterator[Setting]:
    """Up to 4.6 in centimetres under another name."""
    if f"{name}_CM" in readout:
        yield _exactly(f"{name}_CM", wanted_m * 100.0, why)
    else:
        yield _exactly(name, wanted_m, why)


def _proximity() -> Iterator[Setting]:
    for number in PROXIMITY_SENSORS:
        yield Setting(
            f"PRX{number}_TYPE",
            lambda v: v not in (PROXIMITY_MAVLINK, PROXIMITY_RANGEFINDER),
            lambda v: 0.0,
            "this proximity sensor uses the forward range, and avoids the leader as an obstacle",
            optional=True,
            restart=True,
        )


def _scripting(readout: Readout) -> Iterator[Setting]:
    yield _exactly("SCR_ENABLE", 1.0, "the applet is a script", restart=True)
    yield _bit_off(
        "SCR_DIR_DISABLE", SCRIPTS_NOT_LOADED, "scripts on the card are not loaded", restart=True
    )
    yield from _heap(readout)
    yield Setting(
        "SCR_VM_I_COUNT",
        lambda v: v >= INSTRUCTIONS,
        lambda v: INSTRUCTIONS,
        "with fewer instructions the autopilot may stop the applet in the middle of an update",
    )


def _heap(readout: Readout) -> Iterator[Setting]:
    """Where the board is known and can carry the applet; `checks` says so of the others."""
    board, applet = readout.board, readout.applet
    need = applet.needs_bytes(readout.version)
    if board is None or board.heap_bytes < need:
        return
    most = board.most_heap_bytes
    yield Setting(
        HEAP,
        lambda v: need <= v <= most,
        lambda v: float(board.heap_bytes),
        f"{applet.file} needs {need}, and {board.name} has no more than {most}",
        restart=True,
    )


def _guided() -> Iterator[Setting]:
    yield _bit_off(
        "GUID_OPTIONS",
        GUIDED_BY_WAYPOINTS,
        "with waypoint navigation for guided points (bit 6) the applet's limit has no effect",
    )
    yield Setting(
        "GUID_TIMEOUT",
        lambda v: 0.0 < v <= LONGEST_GUIDED_TIMEOUT_S,
        lambda v: GUIDED_TIMEOUT_S,
        "a vehicle must stop soon after its velocity commands end",
        optional=True,
    )
    for name, units_per_mps in (("RTL_SPEED", 100.0), ("RTL_SPEED_MS", 1.0)):
        yield Setting(
            name,
            lambda v: v > 0.0,
            lambda v, units=units_per_mps: RTL_SPEED_MPS * units,  # type: ignore[misc]
            "with 0 the vehicle returns home at the speed parameter, which the applet lowers",
            optional=True,
        )


def _limits(readout: Readout) -> Iterator[Setting]:
    """How quickly the vehicle can get away; higher values of the pilot are kept.

    Neither knows 0 as no limit: AC_WPNav.h takes its default of 2.5 m/s^2 for an acceleration of 0,
    and the position controller (AP_Math/control.cpp, shape_accel_xy) stops working at a jerk of 0.
    """
    yield _at_least(
        readout,
        ACCELERATION,
        "the follower must brake and fly back this quickly when its leader reverses",
    )
    yield _at_least(
        readout, JERK, "the acceleration must build up this quickly when the leader reverses"
    )
    yield _at_least(readout, LEAN, "in wind, too, the follower must be able to brake so quickly")


def _at_least(readout: Readout, limit: VehicleLimit, why: str) -> Setting:
    """A lower bound in SI units, under the first of the names that the vehicle has."""
    name = next((one for one in limit.names if one in readout), next(iter(limit.names)))
    wanted = LEAST_LIMITS[limit] / limit.names[name]
    return Setting(name, lambda v: v >= wanted - TOLERANCE, lambda v: wanted, why)


def _applet(readout: Readout) -> Iterator[Setting]:
    if "ECHO_ENABLE" not in readout:
        return
    yield _exactly("ECHO_ENABLE", 1.0, "the applet does nothing while it is 0")
    if identify(readout.parameters) != readout.applet:
        return  # the one that shall run has other parameters
    named = readout.sonar_named
    by_sonar = applet_by_sonar(readout.sonar) if named else {}
    for row in applet_parameters(readout.applet):
        if row.name in ("ECHO_ENABLE", "ECHO_MIRROR", FORMAT):
            continue
        if row.name in by_sonar:
            yield _of_sonar(row, by_sonar[row.name])
            continue
        yield Setting(
            row.name,
            lambda v, low=row.low, high=row.high: low - TOLERANCE <= v <= high + TOLERANCE,  # type: ignore[misc]
            lambda v, default=row.default: default,  # type: ignore[misc]
            f"the applet accepts {row.low:g} to {row.high:g} only",
        )


def _of_sonar(row: AppletParameter, by_file: BySonar) -> Setting:
    """As the sonar's file says, and as the applet takes it."""
    return Setting(
        row.name,
        lambda v: by_file.fits(v) and row.low - TOLERANCE <= v <= row.high + TOLERANCE,
        lambda v: by_file.value,
        by_file.why,
    )
