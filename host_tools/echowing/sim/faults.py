"""Timed faults of a scenario at work in its flight: each begins, lasts and ends at its times.

Faults live in the vehicles, the radios, the pilots and around the ground tool, never in what is
flown: the follow session, the applet and the co-processor's core learn of them as in the field.
"""

import math
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from echowing.geo import GlobalPosition, Ned, displace, ned_between
from echowing.sim.fault_section import LEADER, FaultSection
from echowing.sim.scenario import LeaderEvent
from echowing.sim.vehicle.modes import POSITIONED
from echowing.sim.world.sonar import LONGEST_M, SHORTEST_M

if TYPE_CHECKING:
    from echowing.sim.aircraft import SimFollower, SimVehicle
    from echowing.sim.flight import FormationFlight

Step = Callable[[float], None]
Running = AbstractContextManager[Step]

SWITCH_CHANNEL, SWITCH_ON_US, SWITCH_OFF_US = 7, 1900, 1000
# A receiver that is lost: the estimator goes on by its accelerometers, whose error this is (a
# degree of lean is 0.17 m/s2, and it knows the lean better than that; assumed).
DEAD_RECKONING_MPS2 = 0.1
# EKF3 gives its position up 7 s after the last one (posRetryTimeNoVel_ms, AP_NavEKF3.cpp); the
# check of the vehicle acts a second later and lands it (ekf_check.cpp; FS_EKF_ACTION 1).
ESTIMATE_LOST_S, LANDS_AFTER_S = 7.0, 8.0


class Faults:
    """The faults of one flight; `step` before each step of the world."""

    def __init__(self, faults: Sequence[FaultSection], flight: "FormationFlight") -> None:
        self._flight = flight
        self._waiting = sorted(faults, key=lambda fault: fault.at_s)
        self._running: list[tuple[FaultSection, Running, Step]] = []

    @property
    def in_force(self) -> list[FaultSection]:
        """Those that have begun and are not over."""
        return [fault for fault, _, _ in self._running]

    def step(self, t_s: float) -> None:
        """End what is over, begin what is due, and keep going what goes on."""
        for entry in [one for one in self._running if t_s >= one[0].ends_s]:
            self._running.remove(entry)
            entry[1].__exit__(None, None, None)
        while self._waiting and t_s >= self._waiting[0].at_s:
            fault = self._waiting.pop(0)
            running = _BEGIN[fault.kind](self._flight, fault)
            self._running.append((fault, running, running.__enter__()))
        for _, _, go_on in self._running:
            go_on(t_s)


def _nothing(t_s: float) -> None:
    """Many faults need no more than to begin and to end."""


@contextmanager
def _changed(owner: object, name: str, value: object) -> Iterator[Step]:
    """Most faults are one thing that is otherwise while they last."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    yield _nothing
    setattr(owner, name, before)


def _vehicle(flight: "FormationFlight", fault: FaultSection) -> "SimVehicle":
    return flight.leader if fault.vehicle == LEADER else _follower(flight, fault)


def _follower(flight: "FormationFlight", fault: FaultSection) -> "SimFollower":
    return flight.followers[(fault.vehicle or 0) - 1 - LEADER]


# ---- radios and receivers -----------------------------------------------------------------------


@contextmanager
def _outage(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """Nothing gets through a vehicle's radio: down to the ground, up to the vehicle, or both."""
    link = flight.ground.links[fault.vehicle or 0]
    ways = [link.down] * (fault.way != "up") + [link.up] * (fault.way != "down")
    for way in ways:
        way.outage = True
    yield _nothing
    for way in ways:
        way.outage = False


@contextmanager
def _bytes_lost(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """A vehicle's radio, or the wire to its co-processor, loses more bytes than before."""
    if fault.link == "wire":
        follower = _follower(flight, fault)
        ways = {"down": follower.wire_down, "up": follower.wire_up}
    else:
        link = flight.ground.links[fault.vehicle or 0]
        ways = {"down": link.down.cutter, "up": link.up.cutter}
    cutters = [cutter for way, cutter in ways.items() if fault.way in (way, "both")]
    before = [cutter.loss for cutter in cutters]
    for cutter in cutters:
        cutter.loss = replace(cutter.loss, byte_loss=fault.byte_loss)
    yield _nothing
    for cutter, loss in zip(cutters, before, strict=True):
        cutter.loss = loss


@contextmanager
def _gps_jump(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The estimated position is off by `jump_ned_m` at once."""
    drift = _vehicle(flight, fault).drift
    drift.jump_to(_sum(drift.jump_ned_m, fault.jump_ned_m))
    yield _nothing
    drift.jump_to(_sum(drift.jump_ned_m, tuple(-one for one in fault.jump_ned_m)))


@contextmanager
def _gps_lost(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """No fix: the estimate runs away by itself, is given up, and the autopilot lands."""
    vehicle = _vehicle(flight, fault)
    began_s = flight.t_s
    before = vehicle.drift.jump_ned_m
    bearing_rad = random.Random(f"{flight.seed} dead reckoning {fault.vehicle}").uniform(
        -math.pi, math.pi
    )

    def go_on(t_s: float) -> None:
        reports = vehicle.autopilot.reports
        reports.has_fix = False
        lost_s = t_s - began_s
        off_m = 0.5 * DEAD_RECKONING_MPS2 * lost_s * lost_s
        if lost_s <= LANDS_AFTER_S:
            off = (off_m * math.cos(bearing_rad), off_m * math.sin(bearing_rad), 0.0)
            vehicle.drift.jump_ned_m = _sum(before, off)
        reports.has_position = lost_s < ESTIMATE_LOST_S
        if lost_s >= LANDS_AFTER_S and vehicle.autopilot.modes.mode in POSITIONED:
            vehicle.autopilot.modes.ekf_failsafe()

    yield go_on
    vehicle.autopilot.reports.has_fix = vehicle.autopilot.reports.has_position = True
    vehicle.drift.jump_to(before)


@contextmanager
def _home_differs(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """Its home lies `height_m` higher than the leader's: it took off from a hill."""
    places = _vehicle(flight, fault).autopilot.places
    north_m, east_m, down_m = places.home_ned_m
    places.home_ned_m = (north_m, east_m, down_m - fault.height_m)
    yield _nothing


# ---- sonar, gimbal, co-processor, applet --------------------------------------------------------


@contextmanager
def _sonar_dead(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The sensor answers, and hears nothing."""
    with _hearing(_follower(flight, fault), lambda range_m: None):
        yield _nothing


@contextmanager
def _sonar_stuck(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The sensor answers with what it heard last."""
    follower = _follower(flight, fault)
    last_m = follower.sensor.last_range_m
    with _hearing(follower, lambda range_m: last_m):
        yield _nothing


@contextmanager
def _sonar_wild(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """Each reading is anything at all, as in another sonar's noise."""
    chance = random.Random(f"{flight.seed} wild {fault.vehicle} {fault.at_s}")
    with _hearing(_follower(flight, fault), lambda range_m: chance.uniform(SHORTEST_M, LONGEST_M)):
        yield _nothing


@contextmanager
def _hearing(
    follower: "SimFollower", hears: Callable[[float | None], float | None]
) -> Iterator[None]:
    """Puts `hears` between the sonar and what it makes of an echo; the newest fault counts."""
    before, follower.hears = follower.hears, hears
    yield
    if follower.hears is hears:
        follower.hears = before


@contextmanager
def _coprocessor_off(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """A brown-out: the board is dead, and starts when its supply is back."""
    follower = _follower(flight, fault)
    follower.stop_coprocessor()
    yield _nothing
    follower.start_coprocessor(flight.t_s)


@contextmanager
def _coprocessor_reset(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The board starts anew, at once."""
    _follower(flight, fault).start_coprocessor(flight.t_s)
    yield _nothing


@contextmanager
def _script_killed(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The applet stops running; its end is the autopilot starting its scripts again."""
    autopilot = _follower(flight, fault).autopilot
    autopilot.kill_script()
    yield _nothing
    autopilot.restart_scripting()


def _sonar_unplugged(flight: "FormationFlight", fault: FaultSection) -> Running:
    """Nothing answers on the co-processor's bus."""
    return _changed(_follower(flight, fault).sensor, "plugged", value=False)


def _late_echoes(flight: "FormationFlight", fault: FaultSection) -> Running:
    """A loud reflector `range_m` ahead: its echo may come back into a later reading."""
    return _changed(_follower(flight, fault), "reflector_m", fault.range_m)


def _narrow_beam(flight: "FormationFlight", fault: FaultSection) -> Running:
    """The beam is narrower than everybody thinks."""
    half_rad = math.radians(fault.half_angle_deg)
    return _changed(_follower(flight, fault), "beam_half_angle_rad", half_rad)


def _servo_jammed(flight: "FormationFlight", fault: FaultSection) -> Running:
    """Pan and tilt stay where they are, whatever their pulses."""
    return _changed(_follower(flight, fault).gimbal, "jammed", value=True)


@contextmanager
def _autopilot_rebooted(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """Its pilot lands it, the autopilot restarts on the ground; in the end he takes off again."""
    pilot = flight.pilots[(fault.vehicle or 0) - 1 - LEADER]
    autopilot = _follower(flight, fault).autopilot
    height_m = autopilot.height_above_home_m()
    restarted = False
    pilot.takes_over("LAND")

    def go_on(t_s: float) -> None:
        nonlocal restarted
        if not restarted and not autopilot.modes.armed:
            restarted = True
            autopilot.reboot()

    yield go_on
    if restarted:
        autopilot.arm_and_fly(height_m)
    pilot.comes_back()


# ---- people -------------------------------------------------------------------------------------


@contextmanager
def _pilot_takes_over(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """A follower's pilot takes it in another mode, and puts it back in Guided in the end."""
    pilot = flight.pilots[(fault.vehicle or 0) - 1 - LEADER]
    pilot.takes_over(fault.mode)
    yield _nothing
    pilot.comes_back()


@contextmanager
def _stop_switch(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """A stop switch is on; once it is off again, the pilots it has stopped engage anew."""
    autopilot = _vehicle(flight, fault).autopilot
    autopilot.set_rc(SWITCH_CHANNEL, SWITCH_ON_US)
    yield _nothing
    autopilot.set_rc(SWITCH_CHANNEL, SWITCH_OFF_US)
    for number, pilot in enumerate(flight.pilots):
        if fault.vehicle in (LEADER, number + 1 + LEADER):
            pilot.engages_again()


@contextmanager
def _tool_stopped(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The operator ends the ground tool, which first stops what it has moved."""
    flight.ground.end(flight.t_s)
    yield _nothing


@contextmanager
def _tool_killed(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The ground tool is dead at once; its end is the operator starting it again."""
    flight.ground.running = False
    yield _nothing
    flight.ground.start(flight.new_session())


# ---- the leader ---------------------------------------------------------------------------------


@contextmanager
def _leader_does(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The leader leaves its path and does something else; then it goes on with its path."""
    flight.pilot.interrupt(_leader_event(flight, fault), flight.followers[0].position_ned_m)
    yield _nothing
    flight.pilot.resume()


def _leader_event(flight: "FormationFlight", fault: FaultSection) -> LeaderEvent:
    if fault.kind == "leader_stops":
        return LeaderEvent(at_s=fault.at_s, act="hold", label="stops")
    if fault.kind == "leader_attacks":
        return LeaderEvent(
            at_s=fault.at_s, act="at_follower", label="attacks", speed_mps=fault.speed_mps
        )
    north, east, _ = flight.leader.velocity_ned_mps
    if fault.kind == "leader_climbs":
        velocity = (north, east, -fault.climb_mps)
        return LeaderEvent(at_s=fault.at_s, act="fly", label="climbs", velocity_ned_mps=velocity)
    mps = math.hypot(north, east)
    if mps < 0.1:
        yaw_rad = flight.leader.body.yaw_rad
        north, east, mps = math.cos(yaw_rad), math.sin(yaw_rad), 1.0
    back = (-north / mps * fault.speed_mps, -east / mps * fault.speed_mps, 0.0)
    return LeaderEvent(at_s=fault.at_s, act="fly", label="reverses", velocity_ned_mps=back)


# ---- the thesis's fault -------------------------------------------------------------------------


@contextmanager
def _north_south_offset(flight: "FormationFlight", fault: FaultSection) -> Iterator[Step]:
    """The thesis's frame fault (4.3.2.1): on north and south courses the slot is abeam.

    The follower sat well behind the leader on east and west courses and beside it on north and
    south ones; so here the point is turned about the leader by 90 degrees on those.
    """
    flight.ground.distort = lambda message: _turned_point(flight, message)
    yield _nothing


def _turned_point(flight: "FormationFlight", message: Any) -> Any:
    fix = flight.ground.session.leader.fix
    if message.get_type() != "SET_POSITION_TARGET_GLOBAL_INT" or fix is None:
        return message
    if abs(fix.velocity_ned_mps[0]) <= abs(fix.velocity_ned_mps[1]):
        return message
    centre = fix.position
    point = GlobalPosition(message.lat_int / 1e7, message.lon_int / 1e7, centre.alt_m)
    north_m, east_m, _ = ned_between(centre, point)
    turned = displace(centre, (-east_m, north_m, 0.0))
    message.lat_int, message.lon_int = round(turned.lat_deg * 1e7), round(turned.lon_deg * 1e7)
    return message


def _sum(a: Ned, b: Sequence[float]) -> Ned:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


_BEGIN: dict[str, Callable[["FormationFlight", FaultSection], Running]] = {
    "autopilot_rebooted": _autopilot_rebooted,
    "bytes_lost": _bytes_lost,
    "coprocessor_off": _coprocessor_off,
    "coprocessor_reset": _coprocessor_reset,
    "gps_jump": _gps_jump,
    "gps_lost": _gps_lost,
    "home_differs": _home_differs,
    "late_echoes": _late_echoes,
    "leader_attacks": _leader_does,
    "leader_climbs": _leader_does,
    "leader_reverses": _leader_does,
    "leader_stops": _leader_does,
    "narrow_beam": _narrow_beam,
    "north_south_offset": _north_south_offset,
    "outage": _outage,
    "pilot_takes_over": _pilot_takes_over,
    "script_killed": _script_killed,
    "servo_jammed": _servo_jammed,
    "sonar_dead": _sonar_dead,
    "sonar_stuck": _sonar_stuck,
    "sonar_unplugged": _sonar_unplugged,
    "sonar_wild": _sonar_wild,
    "stop_switch": _stop_switch,
    "tool_killed": _tool_killed,
    "tool_stopped": _tool_stopped,
}
