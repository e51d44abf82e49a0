"""Flight modes and arming of the simulated autopilot."""

from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.geo import Ned
from echowing.sim.vehicle.guided import Body, Controls, Guided, SubMode
from echowing.sim.vehicle.parameters import Parameters
from echowing.sim.vehicle.places import Places
from echowing.sim.vehicle.rangefinder import NO_DATA, MavlinkRangefinder
from echowing.sim.vehicle.wpnav import TrackLimits

STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, POSHOLD, BRAKE = 0, 2, 3, 4, 5, 6, 9, 16, 17
MODES = {
    "STABILIZE": STABILIZE,
    "ALT_HOLD": ALT_HOLD,
    "AUTO": AUTO,
    "GUIDED": GUIDED,
    "LOITER": LOITER,
    "RTL": RTL,
    "LAND": LAND,
    "POSHOLD": POSHOLD,
    "BRAKE": BRAKE,
}
_NAMES = {number: name for name, number in MODES.items()}
# Modes in which arming makes sense to the autopilot (Mode::allows_arming).
_ARMABLE = {STABILIZE, ALT_HOLD, GUIDED, LOITER, POSHOLD}

# Modes that need a position (Mode::requires_position): where it is lost, they end in Land.
POSITIONED = {AUTO, GUIDED, LOITER, RTL, POSHOLD, BRAKE}

# AP_Arming.h
_CHECK_ALL = 1
_CHECK_RANGEFINDER = 1 << 15
_CHECK_AUX_AUTH = 1 << 17
AUX_AUTH_PLACES = 3
AUX_AUTH_TEXT_CHARACTERS = 42
_PREARM_TEXT_PERIOD_S = 30.0  # AP_Arming.cpp: PREARM_DISPLAY_PERIOD
# FS_GCS_ENABLE -> mode (ArduCopter/events.cpp); SmartRTL is flown as RTL, 2 goes on in Auto.
_GCS_FAILSAFE_MODES = {1: RTL, 2: RTL, 3: RTL, 4: RTL, 5: LAND, 6: RTL, 7: BRAKE}
_FAILSAFE_CONTINUES_IN_AUTO = 2

Say = Callable[[int, str], None]


class Arming:
    """Arming checks: the rangefinder, and the auxiliary authorisations of scripts."""

    def __init__(self, parameters: Parameters, rangefinder: MavlinkRangefinder) -> None:
        self._parameters = parameters
        self._rangefinder = rangefinder
        self._answers: list[str | bool | None] = []
        self.script_error: str | None = None

    def new_id(self) -> int | None:
        """Reserve an authorisation; None: all are taken."""
        if len(self._answers) >= AUX_AUTH_PLACES:
            return None
        self._answers.append(None)
        return len(self._answers) - 1

    def passed(self, auth_id: int) -> None:
        """Let the vehicle arm as far as this authorisation goes."""
        if 0 <= auth_id < len(self._answers):
            self._answers[auth_id] = True

    def failed(self, auth_id: int, reason: str) -> None:
        """Refuse arming for a reason."""
        if 0 <= auth_id < len(self._answers):
            self._answers[auth_id] = reason[:AUX_AUTH_TEXT_CHARACTERS]

    def forget_scripts(self) -> None:
        """Scripting starts again (AP_Arming, reset_all_aux_auths): no authorisation is reserved."""
        self._answers.clear()
        self.script_error = None

    def objection(self) -> str | None:
        """The first reason not to arm; None: there is none."""
        if self._checks(_CHECK_RANGEFINDER) and self._rangefinder.status == NO_DATA:
            return "Rangefinder 1: No Data"
        if self.script_error is not None:  # AP_Scripting.cpp, arming_checks
            return f"Scripting: {self.script_error}"
        if self._checks(_CHECK_AUX_AUTH):
            for answer in self._answers:
                if isinstance(answer, str):
                    return answer
            if None in self._answers:
                return "Waiting for auxiliary authorisation"
        return None

    def _checks(self, bit: int) -> bool:
        if self._parameters.dialect.skips_checks:
            return not int(self._parameters.value("ARMING_SKIPCHK")) & bit
        return bool(int(self._parameters.value("ARMING_CHECK")) & (_CHECK_ALL | bit))


class _Carried:
    """Controls of a body that moves by itself: nothing the autopilot does moves it."""

    def set_limits(self, limits: TrackLimits) -> None: ...

    def start_guided(self, speed_limit_mps: float) -> None: ...

    def guided_position(self, target_ned_m: Ned, yaw_rad: float | None = None) -> None: ...

    def guided_posvel(
        self,
        target_ned_m: Ned,
        velocity_ned_mps: Ned,
        yaw_rad: float | None = None,
        acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> None: ...

    def guided_velocity(self, velocity_ned_mps: Ned, yaw_rad: float | None = None) -> None: ...

    def set_speed_limit(self, speed_mps: float) -> None: ...

    def start_auto(self, waypoints_ned_m: Sequence[Ned], speed_mps: float) -> None: ...

    def hold(self) -> None: ...

    def land(self) -> None: ...

    def take_off(self, altitude_m: float) -> None: ...


class FlightModes:
    """Mode, arming, and what each mode makes the vehicle do.

    A vehicle that starts in the air is armed and in Guided. Stabilize and the other modes flown
    by hand hold the place, as a good pilot would; what a thrown throttle does is not modelled.
    """

    def __init__(
        self,
        body: Body,
        parameters: Parameters,
        places: Places,
        arming: Arming,
        *,
        say: Say,
        on_change: Callable[[], None],
        log_target: Callable[[SubMode, Ned, Ned], None],
    ) -> None:
        self._body = body
        self._parameters = parameters
        self._places = places
        self._arming = arming
        self._say = say
        self._on_change = on_change
        self.controls: Controls = body if isinstance(body, Controls) else _Carried()
        self.guided = Guided(self.controls, parameters, places.within_fence, log_target)
        self.armed = not body.landed
        self.mode = STABILIZE
        self.failsafe = False
        self.waypoints: list[Ned] = []
        self.mission_speed_mps: float | None = None
        self.take_off_first_m: float | None = None
        self.after_mission: int | None = None
        self._ground_since_s: float | None = None
        self._arrived_s: float | None = None
        self._told_s = 0.0
        self._heard_gcs_s: float | None = None
        if self.armed:
            self._enter(GUIDED)

    @property
    def flying(self) -> bool:
        """Armed and off the ground."""
        return self.armed and not self._body.landed

    # ---- modes ----------------------------------------------------------------------------------

    def set_mode(self, mode: int) -> bool:
        """Change the mode; False: unknown, or not possible now."""
        if mode not in _NAMES or (mode == AUTO and not self.waypoints):
            name = _NAMES.get(mode, str(mode))
            self._say(mavlink.MAV_SEVERITY_WARNING, f"Mode change to {name} failed")
            return False
        if mode != self.mode:
            self._enter(mode)
        return True

    def _enter(self, mode: int) -> None:
        self.mode = mode
        self._arrived_s = None
        if mode == GUIDED:
            self.guided.start()
        elif mode == AUTO:
            self._start_waypoints()
        elif mode == RTL:
            self._start_return()
        elif mode == LAND:
            self.controls.land()
        else:
            # LOIT_* and BRAKE_*, not WP_*
            lean = self._parameters.motion_limits().lean
            self.controls.set_limits(TrackLimits(lean=lean))
            self.controls.hold()
        self._on_change()

    def position_target(self) -> Ned | None:
        """The point it is flying to: Guided's position target, or Auto's waypoint."""
        if self.mode == GUIDED:
            return self.guided.target_ned_m
        if self.mode != AUTO or not self.waypoints:
            return None
        navigator: Any = getattr(self.controls, "navigator", None)
        index = navigator.waypoint_index if navigator is not None else 0
        return self.waypoints[min(index, len(self.waypoints) - 1)]

    def set_speed(self, speed_mps: float) -> bool:
        """Speed limit of Guided or of the mission; False in other modes."""
        if self.mode == GUIDED:
            self.guided.set_speed(speed_mps)
            return True
        if self.mode == AUTO:
            self.controls.set_speed_limit(speed_mps)
            return True
        return False

    def pause(self, paused: bool) -> bool:
        """Pause or continue Guided; False in other modes."""
        if self.mode != GUIDED:
            return False
        if paused:
            self.guided.pause()
        else:
            self.guided.resume()
        return True

    def start_mission(self, waypoints: Sequence[Ned], speed_mps: float | None) -> None:
        """Fly waypoints (estimated NED) in Auto, at a speed or at the speed parameter."""
        self.waypoints = list(waypoints)
        self.mission_speed_mps = speed_mps
        self.take_off_first_m = self.after_mission = None
        self._enter(AUTO)

    def _start_waypoints(self) -> None:
        if self._body.landed and self.take_off_first_m is not None:
            if self.armed:
                self.controls.take_off(self.take_off_first_m)
            return
        default_mps = self._parameters.waypoint_start_speed_mps()
        self.controls.set_limits(self._parameters.motion_limits())
        self.controls.start_auto(self.waypoints, self.mission_speed_mps or default_mps)

    def _start_return(self) -> None:
        """Climb, fly home, wait, land (ArduCopter/mode_rtl.cpp); at the speed parameter if 0."""
        parameters, names = self._parameters, self._parameters.dialect
        default_mps = parameters.waypoint_start_speed_mps()
        speed_mps = parameters.value(names.rtl_speed) * names.rtl_speed_scale
        height_m = parameters.value(names.rtl_altitude) * names.rtl_altitude_scale
        north_m, east_m, down_m = self._places.here_ned_m()
        home = self._places.home_ned_m
        down_m = min(down_m, home[2] - height_m)
        path = [(north_m, east_m, down_m), (home[0], home[1], down_m)]
        self.controls.set_limits(parameters.motion_limits())
        self.controls.start_auto(path, speed_mps or default_mps)

    # ---- arming ---------------------------------------------------------------------------------

    def arm(self, *, force: bool = False) -> bool:
        """Arm if nothing speaks against it; says why not."""
        if self.armed:
            return True
        reason = None if force else self._arming.objection()
        if reason is None and self.mode not in _ARMABLE:
            reason = "Mode not armable"
        if reason is not None:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, f"Arm: {reason}")
            return False
        self.armed = True
        self._ground_since_s = None
        self._places.set_home_here()
        self._say(mavlink.MAV_SEVERITY_INFO, "Arming motors")
        self._on_change()
        return True

    def disarm(self) -> bool:
        """Disarm on the ground; in the air it is refused."""
        if self.armed and not self._body.landed:
            return False
        if self.armed:
            self.armed = False
            self._say(mavlink.MAV_SEVERITY_INFO, "Disarming motors")
            self._on_change()
        return True

    def take_off(self, altitude_m: float) -> bool:
        """Guided take-off; False unless armed, in Guided and on the ground."""
        ready = self.armed and self._body.landed and self.mode == GUIDED
        if not ready or not altitude_m > 0.0:
            return False
        self.guided.take_off(altitude_m)
        return True

    # ---- time -----------------------------------------------------------------------------------

    def heard_ground_station(self, t_s: float) -> None:
        """A heartbeat of the pilot's own ground station has come."""
        self._heard_gcs_s = t_s
        if self.failsafe:
            self.failsafe = False
            self._say(mavlink.MAV_SEVERITY_WARNING, "GCS Failsafe Cleared")

    def step(self, t_s: float) -> None:
        """What time brings: arrivals, landings, disarming, fail-safe, complaints."""
        if not self.armed:
            self._complain(t_s)
            return
        if self._body.landed:
            self._on_ground(t_s)
            return
        self._ground_since_s = None
        if self.mode in (AUTO, RTL):
            self._arrive(t_s)
        self._watch_ground_station(t_s)

    def ekf_failsafe(self) -> None:
        """The estimator has no position left: land (FS_EKF_ACTION 1, ArduCopter/ekf_check.cpp)."""
        self._say(mavlink.MAV_SEVERITY_CRITICAL, "EKF Failsafe: changed to LAND Mode")
        self._enter(LAND)

    def _complain(self, t_s: float) -> None:
        if t_s - self._told_s < _PREARM_TEXT_PERIOD_S:
            return
        self._told_s = t_s
        self.tell_objection()

    def tell_objection(self) -> None:
        """Say why the vehicle would not arm, if it would not."""
        reason = self._arming.objection()
        if reason is not None:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, f"PreArm: {reason}")

    def _on_ground(self, t_s: float) -> None:
        if self.mode in (LAND, RTL):
            self.disarm()
            return
        if self._ground_since_s is None:
            self._ground_since_s = t_s
        if t_s - self._ground_since_s >= self._parameters.value("DISARM_DELAY") > 0.0:
            self.disarm()

    def _arrive(self, t_s: float) -> None:
        navigator: Any = getattr(self.controls, "navigator", None)
        if self.mode == AUTO and navigator is None:
            self._end_mission_take_off()
            return
        if navigator is None or not navigator.finished:
            return
        if self._arrived_s is None:
            self._arrived_s = t_s
        if self.mode == AUTO:
            if self.after_mission is not None:
                self.set_mode(self.after_mission)
            return
        if t_s - self._arrived_s >= self._parameters.value("RTL_LOIT_TIME") / 1000.0:
            self.controls.land()

    def _end_mission_take_off(self) -> None:
        """Go on to the waypoints once the mission's take-off is within 0.5 m of its height."""
        wanted_m = self.take_off_first_m
        if wanted_m is not None and self._places.height_m() > wanted_m - 0.5:
            self._start_waypoints()

    def _watch_ground_station(self, t_s: float) -> None:
        wish = int(self._parameters.value("FS_GCS_ENABLE"))
        if wish == 0 or self._heard_gcs_s is None or self.failsafe:
            return
        if t_s - self._heard_gcs_s < self._parameters.value("FS_GCS_TIMEOUT"):
            return
        self.failsafe = True
        self._say(mavlink.MAV_SEVERITY_WARNING, "GCS Failsafe")
        if not (wish == _FAILSAFE_CONTINUES_IN_AUTO and self.mode == AUTO):
            self.set_mode(_GCS_FAILSAFE_MODES.get(wish, RTL))
