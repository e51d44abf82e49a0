"""Motion of one ArduCopter: target shaping, position and velocity control, lean lag, yaw.

The structure is the autopilot's own (libraries/AC_AttitudeControl/AC_PosControl.cpp and
ArduCopter/mode_guided.cpp): a target is shaped into a smooth desired motion, a cascade of
controllers holds the vehicle on it, the lean is shaped on its way to the wanted one, the body
follows after a lag, and air drags on it. Up to 4.7 and from 4.8 on the shaping differs
(`tuning_of`). Flown on the same targets, it leans as SITL's quad does within a degree (RMS). Gains
are ArduCopter's defaults; limits are what the autopilot's parameters say (`set_limits`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import atan2, cos, exp, inf, pi, sin, sqrt, tan

from echowing.flight.closing import inverse_sqrt_controller, sqrt_controller
from echowing.geo import GRAVITY_MPS2
from echowing.sim.vehicle.estimate import EstimatedPosition
from echowing.sim.vehicle.parameters import Generation
from echowing.sim.vehicle.shaping import (
    PREDICTIVE,
    STEPPED,
    ShapingLaw,
    axis_speed,
    clamp,
    limit_lean,
    limit_length,
)
from echowing.sim.vehicle.wpnav import (
    INPUT_S,
    Ned,
    TrackLimits,
    WaypointNavigator,
    along_limit,
)

# The autopilot's loop takes 2.5 ms. On targets that shake by 0.1 m at 0.9 Hz steps of 20 ms lean by
# 1.9 degrees (RMS) otherwise than SITL, steps of 10 ms by 0.6.
LONGEST_STEP_S = 0.01
HOVER_THROTTLE = 0.38  # SITL's quad hovers at this
# Below this share of the speed limit the heading is kept (AC_PosControl.cpp, yaw of the path).
LOOK_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Tuning:
    """Gains and airframe of one vehicle (SI units), and how its ArduCopter shapes.

    Values are ArduCopter 4.8's defaults, parameter names beside them, except the airframe's.
    """

    shaping: ShapingLaw = PREDICTIVE
    position_gain: float = 1.0  # PSC_NE_POS_P
    velocity_p: float = 2.0  # PSC_NE_VEL_P
    velocity_i: float = 1.0  # PSC_NE_VEL_I
    velocity_i_max_mps2: float = 10.0  # PSC_NE_VEL_IMAX
    velocity_d: float = 0.25  # PSC_NE_VEL_D
    velocity_filter_hz: float = 5.0  # PSC_NE_VEL_FLTE and PSC_NE_VEL_FLTD
    # The heading is shaped with PILOT_Y_RATE_TC, 0 as it comes; up to 4.7 with ATC_INPUT_TC.
    yaw_input_s: float = 0.0
    angle_gain: float = 4.5  # ATC_ANG_RLL_P, ATC_ANG_PIT_P, ATC_ANG_YAW_P
    down_position_gain: float = 1.0  # PSC_D_POS_P
    down_velocity_p: float = 5.0  # PSC_D_VEL_P
    land_speed_mps: float = 0.5  # LAND_SPD_MS
    land_low_m: float = 10.0  # LAND_ALT_LOW_M
    yaw_rate_rps: float = pi / 3.0  # ATC_RATE_WPY_MAX 60 deg/s
    yaw_acceleration_rps2: float = 270.0 * pi / 180.0  # ATC_ACC_Y_MAX
    guided_timeout_s: float = 3.0  # GUID_TIMEOUT
    # What a reset of the filter moves it by: True, it slews over within its limits where it is told
    # an absolute place (EKFResetMethod::MoveVehicle); False, its desired place moves along, and the
    # next target brings it over (handle_ekf_xy_reset).
    slews_after_reset: bool = True
    # SITL's quad (SIM_Frame.h, SIM_Motor.cpp: 3 kg, 0.385 m2 of rotors, leans 45 degrees at
    # 15.08 m/s) in air of 1.2 kg/m3: drag of the rotors, linear in airspeed,
    # 0.2 sqrt(density x area x weight) / mass, and of the body, quadratic. Its logs show the same.
    drag_per_s: float = 0.246
    drag_per_m: float = 0.035
    # Rate loop and motors: with it the lean follows SITL's own demand within 0.5 degrees (RMS), of
    # 11.
    rate_s: float = 0.025
    thrust_lag_s: float = 0.1  # acceleration loop PSC_D_ACC_* and motors, as recorded take-offs
    # A quad yaws by its propellers' drag alone: weakly. It reaches this share of the rate that is
    # asked of it, with this lag (fitted to RATE's YDes and Y, steps, ramps and sines of yaw on SITL
    # 4.8 and 4.6: 2.4 degrees a second are left of 25).
    yaw_share: float = 0.72
    yaw_lag_s: float = 0.22


_STEPPED = Tuning(shaping=STEPPED, velocity_d=0.5, yaw_input_s=INPUT_S, slews_after_reset=False)
_OF_4_8 = Tuning()
# Up to 4.7 the sources answer a reset alike (handle_ekf_NE_reset); 4.6 and 4.8 were recorded.
_TUNINGS = {
    Generation.V4_5: _STEPPED,
    Generation.V4_6: _STEPPED,
    Generation.V4_7: replace(_STEPPED, velocity_d=_OF_4_8.velocity_d),
    Generation.V4_8: _OF_4_8,
}


def tuning_of(generation: Generation) -> Tuning:
    """What a line of ArduCopter flies like, with its default parameters."""
    return _TUNINGS[generation]


class _Shaped:
    """One axis of the attitude target: an angle (rad) on its way to the one that is wanted."""

    __slots__ = ("acceleration", "angle", "rate")

    def __init__(self, angle: float) -> None:
        self.angle = angle
        self.rate = self.acceleration = 0.0

    def move(self, turn: tuple[float, float], dt: float) -> None:
        """A step with this rate and acceleration."""
        self.rate, self.acceleration = turn
        self.angle += self.rate * dt


class _Aside:
    """How far the vehicle is held beside its desired place, until it has slewed over: m, m/s, m/s2.

    NE_update_offsets of AC_PosControl.cpp.
    """

    __slots__ = ("acc_e", "acc_n", "east", "north", "ve", "vn")

    def __init__(self) -> None:
        self.north = self.east = self.vn = self.ve = self.acc_n = self.acc_e = 0.0

    def slew(self, law: ShapingLaw, fastest: float, limit: float, jerk: float, dt: float) -> None:
        """One step back to nothing, shaped as any desired motion is."""
        vn, ve = law.approach(-self.north, -self.east, self.vn, self.ve, fastest, limit, jerk)
        acc_n, acc_e = law.demand(vn, ve, self.vn, self.ve, limit, jerk)
        step_n, step_e = limit_length(acc_n - self.acc_n, acc_e - self.acc_e, jerk * dt)
        self.acc_n += step_n
        self.acc_e += step_e
        self.north += (self.vn + 0.5 * self.acc_n * dt) * dt
        self.east += (self.ve + 0.5 * self.acc_e * dt) * dt
        self.vn += self.acc_n * dt
        self.ve += self.acc_e * dt


def wrap_pi(angle_rad: float) -> float:
    """The same angle within -pi and pi."""
    return (angle_rad + pi) % (2.0 * pi) - pi


def _lean(north: float, east: float) -> tuple[float, float]:
    """The lean, north and east (rad), whose thrust gives a horizontal acceleration (m/s2)."""
    level = sqrt(north * north + east * east)
    share = atan2(level, GRAVITY_MPS2) / level if level > 0.0 else 0.0
    return north * share, east * share


def _push(north: float, east: float) -> tuple[float, float]:
    """The horizontal acceleration (m/s2) that a lean (rad) gives, while the thrust holds height."""
    lean = sqrt(north * north + east * east)
    share = GRAVITY_MPS2 * tan(lean) / lean if lean > 0.0 else 0.0
    return north * share, east * share


class Copter(EstimatedPosition):
    """Motion of one ArduCopter: position controller, input shaping, attitude lag.

    True state: `north_m east_m down_m vn_mps ve_mps vd_mps` (local NED), `roll_rad pitch_rad
    yaw_rad` and their rates `rollspeed_rps pitchspeed_rps yawspeed_rps`. Targets are in the frame
    of the estimate, which is the truth plus `set_estimate_offset`; the ground is at
    `ground_down_m`. The air moves at `wind_ned_mps`.

    `default_speed_mps` is the speed parameter (WP_SPD): a sub-mode of Guided reads it once, when it
    starts. `set_limits` gives the others. Speed limits: 0 is no limit.
    """

    __slots__ = (
        "_acc_d",
        "_acc_e",
        "_acc_n",
        "_alpha_filter",
        "_alpha_rate",
        "_alpha_thrust",
        "_alpha_yaw",
        "_aside",
        "_control_e",
        "_control_n",
        "_dt",
        "_error_e",
        "_error_n",
        "_fresh",
        "_gap_d",
        "_gap_e",
        "_gap_n",
        "_integral_e",
        "_integral_n",
        "_jerk",
        "_lean_e",
        "_lean_n",
        "_lean_rate_e",
        "_lean_rate_n",
        "_lift_d",
        "_mode",
        "_pos_d",
        "_pos_e",
        "_pos_n",
        "_saturated",
        "_shaped_e",
        "_shaped_n",
        "_shaped_yaw",
        "_slope_e",
        "_slope_n",
        "_speed_limit",
        "_steepest_mps2",
        "_target_acceleration",
        "_target_age_s",
        "_target_velocity",
        "_vel_d",
        "_vel_e",
        "_vel_n",
        "_yaw_command",
        "_yaw_command_rate",
        "default_speed_mps",
        "down_m",
        "east_m",
        "ground_down_m",
        "landed",
        "limits",
        "navigator",
        "north_m",
        "pitch_rad",
        "pitchspeed_rps",
        "roll_rad",
        "rollspeed_rps",
        "target_ned_m",
        "tuning",
        "vd_mps",
        "ve_mps",
        "vn_mps",
        "wind_ned_mps",
        "yaw_rad",
        "yawspeed_rps",
    )

    def __init__(
        self,
        position_ned_m: Ned,
        yaw_rad: float = 0.0,
        *,
        tuning: Tuning | None = None,
        flying: bool = False,
        velocity_ned_mps: Ned = (0.0, 0.0, 0.0),
        ground_down_m: float = 0.0,
    ) -> None:
        self.tuning = tuning or Tuning()
        self.north_m, self.east_m, self.down_m = map(float, position_ned_m)
        self.vn_mps, self.ve_mps, self.vd_mps = map(float, velocity_ned_mps)
        self.roll_rad = self.pitch_rad = 0.0
        self.rollspeed_rps = self.pitchspeed_rps = self.yawspeed_rps = 0.0
        self.yaw_rad = wrap_pi(yaw_rad)
        self.ground_down_m = ground_down_m if flying else self.down_m
        self.landed = not flying
        self.default_speed_mps = 10.0  # WP_SPD
        self.target_ned_m: Ned | None = None
        self.navigator: WaypointNavigator | None = None
        super().__init__()
        self.wind_ned_mps: Ned = (0.0, 0.0, 0.0)
        self._lift_d = 0.0
        self._aside: _Aside | None = None
        self._shaped_yaw = _Shaped(self.yaw_rad)
        self._dt = 0.0
        self._lean_rate_n = self._lean_rate_e = 0.0
        self._shaped_n, self._shaped_e = _Shaped(0.0), _Shaped(0.0)
        self._take_limits(TrackLimits())
        self.settle()

    def settle(self) -> None:
        """Hold here as if long since: leaning against the drag of `wind_ned_mps` and speed."""
        drag_n, drag_e = (0.0, 0.0) if self.landed else self._drag()
        self._control_n, self._control_e = drag_n, drag_e
        self._lean_at_once(*_lean(drag_n, drag_e))
        self._enter(self._shape_hold)

    # ---- commands

    def set_limits(self, limits: TrackLimits) -> None:
        """Limits from now on, other than the speed.

        The autopilot reads them from its parameters when a sub-mode or a mission starts, and when
        the speed is set (AC_PosControl::NE_set_max_speed_accel_m); whoever plays it does so too.
        """
        if limits is not self.limits:  # a new speed mostly brings the same
            self._take_limits(limits)

    def _take_limits(self, limits: TrackLimits) -> None:
        self.limits = limits
        # However high PSC_JERK_NE is, the jerk stays below what the lean's rate makes, and below
        # half the root of WP_ACC times what its acceleration makes (AC_PosControl.cpp).
        snap_mps4 = limits.lean.acceleration_rps2 * GRAVITY_MPS2
        self._jerk = min(
            limits.shaping_jerk_mps3,
            limits.lean.rate_rps * GRAVITY_MPS2,
            0.5 * sqrt(limits.acceleration_mps2 * snap_mps4),
        )
        self._dt = 0.0  # `_prepare` again

    def start_guided(self, speed_limit_mps: float) -> None:
        """Enter Guided: the limit is read once, the target is where the vehicle can stop."""
        self.default_speed_mps = abs(speed_limit_mps)
        self._enter(self._shape_position)
        self.target_ned_m = self.stopping_point()

    def guided_position(self, target_ned_m: Ned, yaw_rad: float | None = None) -> None:
        """Fly to a position (estimated frame). Never times out; the limit caps the total speed."""
        if self._mode != self._shape_position:
            self._enter(self._shape_position)
        self._aim(target_ned_m, (0.0, 0.0, 0.0), yaw_rad)

    def guided_posvel(
        self,
        target_ned_m: Ned,
        velocity_ned_mps: Ned,
        yaw_rad: float | None = None,
        acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> None:
        """Follow a moving point (estimated frame). The limit caps the correction only.

        The point's velocity changes at the acceleration, which comes on top of what corrects; the
        yaw turns on at its rate in the same way.
        Without another command for GUID_TIMEOUT the point stops where it got to.
        """
        if self._mode != self._shape_posvel:
            self._enter(self._shape_posvel)
        self._aim(target_ned_m, velocity_ned_mps, yaw_rad)
        self._target_acceleration = acceleration_ned_mps2
        self._yaw_command_rate = yaw_rate_rps

    def guided_velocity(self, velocity_ned_mps: Ned, yaw_rad: float | None = None) -> None:
        """Fly at a velocity; without another command for GUID_TIMEOUT, stop."""
        if self._mode != self._shape_velocity:
            self._enter(self._shape_velocity)
        self._aim(None, velocity_ned_mps, yaw_rad)

    def set_speed_limit(self, speed_mps: float) -> None:
        """Limit the speed of the sub-mode or mission in force (set_desired_speed); 0: no limit."""
        self._speed_limit = abs(speed_mps)
        if self.navigator is not None and speed_mps > 0.0:
            self.navigator.set_speed(speed_mps)

    def start_auto(self, waypoints_ned_m: Sequence[Ned], speed_mps: float) -> None:
        """Fly a mission of straight legs (estimated frame) at a speed; stop at the last point."""
        start = self.stopping_point()
        self._enter(self._shape_auto)
        self._speed_limit = abs(speed_mps)
        self._pos_n, self._pos_e, self._pos_d = start
        self._vel_n = self._vel_e = self._vel_d = 0.0
        self.navigator = WaypointNavigator(start, waypoints_ned_m, speed_mps, self.limits)

    def hold(self) -> None:
        """Brake and stay: the desired velocity goes to zero within the limits."""
        self._enter(self._shape_hold)

    def land(self) -> None:
        """Descend where the vehicle comes to a stop, until the ground."""
        self._enter(self._shape_land)

    def take_off(self, altitude_m: float) -> None:
        """Climb straight up to this height above the ground (estimated altitude), then stay."""
        self.landed = False
        self._enter(self._shape_take_off)
        here = self.stopping_point()
        self.target_ned_m = (here[0], here[1], self.ground_down_m - altitude_m)

    def stopping_point(self) -> Ned:
        """Where the vehicle comes to rest if it brakes now (estimated frame)."""
        tuning = self.tuning
        north_mps, east_mps = self.est_vn_mps, self.est_ve_mps
        speed = sqrt(north_mps**2 + east_mps**2)
        reach = 0.0
        if speed > 0.0:
            limit = self.limits.acceleration_mps2
            reach = inverse_sqrt_controller(speed, tuning.position_gain, limit) / speed
        drop = inverse_sqrt_controller(
            self.vd_mps, tuning.down_position_gain, self.limits.vertical_acceleration_mps2
        )
        return (
            self.est_north_m + north_mps * reach,
            self.est_east_m + east_mps * reach,
            self.est_down_m + drop,
        )

    def estimate_reset(self, shift_ned_m: Ned) -> None:
        """The filter has moved its estimate by so much at once: no error comes of that by itself.

        NE_handle_ekf_reset of AC_PosControl.cpp, handle_ekf_xy_reset up to 4.7. A height that
        is reset moves the desired one along in each.
        """
        north, east, down = shift_ned_m
        if not (north or east or down):
            return
        self._pos_n += north
        self._pos_e += east
        self._pos_d += down
        absolute = self._shape_position, self._shape_posvel, self._shape_auto
        if self.tuning.slews_after_reset and self._mode in absolute:
            aside = self._aside or _Aside()
            aside.north += north
            aside.east += east
            self._aside = aside

    @property
    def demand_ne_mps2(self) -> tuple[float, float]:
        """Horizontal acceleration that the lean is to give, north and east."""
        return self._control_n, self._control_e

    @property
    def throttle(self) -> float:
        """Of its motors, 0 to 1: what holds it up at its lean, and what makes it climb."""
        if self.landed:
            return 0.0
        weights = (1.0 - self._lift_d / GRAVITY_MPS2) / (cos(self.roll_rad) * cos(self.pitch_rad))
        return clamp(HOVER_THROTTLE * weights, 0.0, 1.0)

    # ---- one step

    def step(self, dt_s: float) -> None:
        """Move on by dt; steps longer than `LONGEST_STEP_S` are split."""
        if self.landed or dt_s <= 0.0:
            return
        parts = int(dt_s / LONGEST_STEP_S + 0.999) if dt_s > LONGEST_STEP_S * 1.001 else 1
        for _ in range(parts):
            self._step(dt_s / parts)
        if self.down_m < self.ground_down_m:
            self._lean_angles()

    def _step(self, dt: float) -> None:
        if self.landed:
            return
        if dt != self._dt:
            self._prepare(dt)
        self._target_age_s += dt
        if self._aside is not None:
            limits = self.limits
            self._aside.slew(
                self.tuning.shaping, self._speed_limit, limits.acceleration_mps2, self._jerk, dt
            )
        self._mode(dt)
        self._control_level(dt)
        self._control_down()
        self._turn(dt)
        flown = (self.est_vn_mps, self.est_ve_mps, self.vd_mps)
        self._move(dt)
        if self.navigator is None:
            self._move_desired(dt)
        else:
            self._follow_navigator(dt, flown)

    def _move_desired(self, dt: float) -> None:
        if self._saturated is None:
            self._pos_n += (self._vel_n + 0.5 * self._acc_n * dt) * dt
            self._pos_e += (self._vel_e + 0.5 * self._acc_e * dt) * dt
            self._vel_n += self._acc_n * dt
            self._vel_e += self._acc_e * dt
        else:
            self._move_desired_within(self._saturated, dt)
        self._pos_d += (self._vel_d + 0.5 * self._acc_d * dt) * dt
        self._vel_d += self._acc_d * dt

    def _move_desired_within(self, beyond: tuple[float, float], dt: float) -> None:
        """The same while the lean is at its limit: what would go further beyond it waits.

        update_pos_vel_accel_xy of AP_Math/control.cpp; `beyond` is the acceleration asked for.
        """
        north, east = beyond
        gap = self._gap_n * north + self._gap_e * east
        if not (gap > 0.0 and self._vel_n * north + self._vel_e * east > 0.0):
            self._pos_n += (self._vel_n + 0.5 * self._acc_n * dt) * dt
            self._pos_e += (self._vel_e + 0.5 * self._acc_e * dt) * dt
        slow = self._error_n * north + self._error_e * east
        growing = self._acc_n * north + self._acc_e * east > 0.0
        if not (slow > 0.0 and growing and self._vel_n * north + self._vel_e * east >= 0.0):
            self._vel_n += self._acc_n * dt
            self._vel_e += self._acc_e * dt

    def _prepare(self, dt: float) -> None:
        """Shares of the way a first-order lag goes within one step, and the lean's limit."""
        tuning = self.tuning
        self._steepest_mps2 = GRAVITY_MPS2 * tan(self.limits.lean.most_rad)
        self._dt = dt
        self._alpha_filter = 1.0 - exp(-dt * 2.0 * pi * tuning.velocity_filter_hz)
        self._alpha_rate = 1.0 - exp(-dt / tuning.rate_s)
        self._alpha_thrust = 1.0 - exp(-dt / tuning.thrust_lag_s)
        self._alpha_yaw = 1.0 - exp(-dt / tuning.yaw_lag_s)

    def _enter(self, mode: Callable[[float], None]) -> None:
        """Start a (sub-)mode: desired motion from the present one, limit from the parameter."""
        self._mode = mode
        self._speed_limit = self.default_speed_mps
        self.navigator = None
        self.target_ned_m = None
        self._target_velocity: Ned = (0.0, 0.0, 0.0)
        self._target_acceleration = (0.0, 0.0, 0.0)
        self._target_age_s = 0.0
        self._yaw_command: float | None = None
        self._yaw_command_rate = 0.0
        self._pos_n, self._pos_e, self._pos_d = self.est_north_m, self.est_east_m, self.est_down_m
        self._aside = None
        self._vel_n, self._vel_e, self._vel_d = self.est_vn_mps, self.est_ve_mps, self.vd_mps
        self._acc_n = self._acc_e = self._acc_d = 0.0
        self._gap_n = self._gap_e = self._gap_d = 0.0
        self._saturated: tuple[float, float] | None = None
        self._fresh = True
        self._error_n = self._error_e = self._slope_n = self._slope_e = 0.0
        # the integrator takes over what is being leaned now: no bump
        self._integral_n, self._integral_e = self._control_n, self._control_e

    def _aim(self, target: Ned | None, velocity: Ned, yaw_rad: float | None) -> None:
        self.target_ned_m = target
        self._target_velocity = velocity
        self._target_age_s = 0.0
        self._yaw_command = yaw_rad
        self._yaw_command_rate = 0.0

    # ---- shaping: each mode turns its target into a desired acceleration

    def _shape_position(self, dt: float) -> None:
        target = self.target_ned_m
        if target is None:
            return
        north, east = target[0] - self._pos_n, target[1] - self._pos_e
        down = target[2] - self._pos_d
        distance = sqrt(north * north + east * east + down * down)
        level = fall = 0.0
        if distance > 0.0:
            direction = (north / distance, east / distance, down / distance)
            track = self.limits
            fastest = along_limit(direction, self._speed_limit, track.climb_mps, track.descent_mps)
            level = fastest * sqrt(direction[0] ** 2 + direction[1] ** 2)
            fall = fastest * abs(direction[2])
        self._shape_level(north, east, 0.0, 0.0, level, dt)
        self._shape_down(down, 0.0, -fall, fall, dt)

    def _shape_posvel(self, dt: float) -> None:
        target = self.target_ned_m
        if target is None:
            return
        if self._target_age_s > self.tuning.guided_timeout_s:
            self._target_velocity = self._target_acceleration = (0.0, 0.0, 0.0)
        vn, ve, vd = self._target_velocity
        an, ae, ad = self._target_acceleration
        track = self.limits
        north, east, down = target
        self._shape_level(
            north - self._pos_n, east - self._pos_e, vn, ve, self._speed_limit, dt, an, ae
        )
        self._shape_down(down - self._pos_d, vd, -track.climb_mps, track.descent_mps, dt, ad)
        half = 0.5 * dt
        self.target_ned_m = (
            north + (vn + an * half) * dt,
            east + (ve + ae * half) * dt,
            down + (vd + ad * half) * dt,
        )
        self._target_velocity = (vn + an * dt, ve + ae * dt, vd + ad * dt)

    def _shape_velocity(self, dt: float) -> None:
        if self._target_age_s > self.tuning.guided_timeout_s:
            self._target_velocity = (0.0, 0.0, 0.0)
        vn, ve, vd = self._target_velocity
        self._shape_speed(vn, ve, vd, dt)

    def _shape_hold(self, dt: float) -> None:
        self._shape_speed(0.0, 0.0, 0.0, dt)

    def _shape_auto(self, dt: float) -> None:
        """Nothing to shape: the legs are smooth by themselves."""

    def _follow_navigator(self, dt: float, flown_mps: Ned) -> None:
        navigator = self.navigator
        if navigator is None:
            return
        aside = self._aside
        north, east = (0.0, 0.0) if aside is None else (aside.north, aside.east)
        navigator.advance(
            dt,
            (self.est_north_m - north, self.est_east_m - east, self.est_down_m),
            (self._gap_n, self._gap_e, self._gap_d),
            flown_mps,
            self.tuning.position_gain,
        )
        self._pos_n, self._pos_e, self._pos_d = self.target_ned_m = navigator.position_m
        self._vel_n, self._vel_e, self._vel_d = navigator.velocity_mps
        self._acc_n, self._acc_e, self._acc_d = navigator.acceleration_mps2
        if aside is not None:
            self._pos_n, self._pos_e = self._pos_n + aside.north, self._pos_e + aside.east
            self._vel_n, self._vel_e = self._vel_n + aside.vn, self._vel_e + aside.ve
            self._acc_n, self._acc_e = self._acc_n + aside.acc_n, self._acc_e + aside.acc_e

    def _shape_land(self, dt: float) -> None:
        tuning = self.tuning
        above_low_m = self.ground_down_m - self.est_down_m - tuning.land_low_m
        braking = sqrt_controller(
            above_low_m, tuning.down_position_gain, self.limits.vertical_acceleration_mps2
        )
        slowest = tuning.land_speed_mps
        self._shape_speed(0.0, 0.0, clamp(braking, slowest, self.limits.descent_mps), dt)

    def _shape_take_off(self, dt: float) -> None:
        target = self.target_ned_m
        if target is None:
            return
        track = self.limits
        self._shape_level(target[0] - self._pos_n, target[1] - self._pos_e, 0.0, 0.0, 0.0, dt)
        self._shape_down(target[2] - self._pos_d, 0.0, -track.climb_mps, track.descent_mps, dt)

    def _shape_level(
        self,
        north: float,
        east: float,
        vn: float,
        ve: float,
        fastest: float,
        dt: float,
        an: float = 0.0,
        ae: float = 0.0,
    ) -> None:
        """Desired horizontal acceleration for a position error; `an`, `ae` come on top."""
        limit, jerk = self.limits.acceleration_mps2, self._jerk
        law, flown_n, flown_e = self.tuning.shaping, self._vel_n, self._vel_e
        aside = self._aside
        if aside is not None:
            north, east = north + aside.north, east + aside.east
            vn, ve, an, ae = vn + aside.vn, ve + aside.ve, an + aside.acc_n, ae + aside.acc_e
        correct_n, correct_e = law.approach(
            north, east, flown_n - vn, flown_e - ve, fastest, limit, jerk
        )
        acc_n, acc_e = law.demand(vn + correct_n, ve + correct_e, flown_n, flown_e, limit, jerk)
        self._demand(acc_n + an, acc_e + ae, dt)

    def _demand(self, acc_n: float, acc_e: float, dt: float) -> None:
        """Let the desired horizontal acceleration move towards a demand, limited in jerk."""
        step_n, step_e = limit_length(acc_n - self._acc_n, acc_e - self._acc_e, self._jerk * dt)
        self._acc_n += step_n
        self._acc_e += step_e

    def _shape_down(
        self,
        error: float,
        feed_forward: float,
        slowest: float,
        fastest: float,
        dt: float,
        acceleration: float = 0.0,
    ) -> None:
        limit, jerk = self.limits.vertical_acceleration_mps2, self.limits.down_jerk_mps3
        wanted = self.tuning.shaping.axis(
            error, self._vel_d, feed_forward, slowest, fastest, limit, jerk
        )
        wanted += acceleration
        self._acc_d += clamp(wanted - self._acc_d, -jerk * dt, jerk * dt)

    def _shape_speed(self, vn: float, ve: float, vd: float, dt: float) -> None:
        """Desired acceleration for a velocity target."""
        limit, jerk = self.limits.acceleration_mps2, self._jerk
        acc_n, acc_e = self.tuning.shaping.speed(vn, ve, self._vel_n, self._vel_e, limit, jerk)
        self._demand(acc_n, acc_e, dt)
        limit, jerk = self.limits.vertical_acceleration_mps2, self.limits.down_jerk_mps3
        wanted = axis_speed(vd - self._vel_d, limit, jerk)
        self._acc_d += clamp(wanted - self._acc_d, -jerk * dt, jerk * dt)

    # ---- control: the desired motion becomes lean, thrust and turn

    def _control_level(self, dt: float) -> None:
        """Position P, velocity PID and feed-forward, as accelerations north and east."""
        tuning = self.tuning
        limit = self.limits.acceleration_mps2
        offset_n, offset_e, _ = self._offset
        north = self._pos_n - self.north_m - offset_n
        east = self._pos_e - self.east_m - offset_e
        self._gap_n, self._gap_e = north, east
        distance = sqrt(north * north + east * east)
        want_n, want_e = self._vel_n, self._vel_e
        if distance > 0.0:
            leash = self._leash()
            if distance > leash:
                self._pos_n += north * (leash / distance - 1.0)
                self._pos_e += east * (leash / distance - 1.0)
                north, east, distance = north * leash / distance, east * leash / distance, leash
            pull = sqrt_controller(distance, tuning.position_gain, limit) / distance
            want_n += north * pull
            want_e += east * pull
        self._velocity_pid(want_n - self.est_vn_mps, want_e - self.est_ve_mps, dt)

    def _leash(self) -> float:
        """Farthest the desired position may run ahead of the estimated one."""
        if self._speed_limit <= 0.0:
            return inf
        return inverse_sqrt_controller(
            self._speed_limit, self.tuning.position_gain, self.limits.acceleration_mps2
        )

    def _velocity_pid(self, raw_n: float, raw_e: float, dt: float) -> None:
        tuning = self.tuning
        if self._fresh:
            self._fresh = False
            self._error_n, self._error_e = raw_n, raw_e
        else:
            share = self._alpha_filter
            moved_n, moved_e = (raw_n - self._error_n) * share, (raw_e - self._error_e) * share
            self._error_n += moved_n
            self._error_e += moved_e
            self._slope_n += (moved_n / dt - self._slope_n) * share
            self._slope_e += (moved_e / dt - self._slope_e) * share
        p, d = tuning.velocity_p, tuning.velocity_d
        self._integrate(dt)
        acc_n = p * self._error_n + d * self._slope_n + self._integral_n + self._acc_n
        acc_e = p * self._error_e + d * self._slope_e + self._integral_e + self._acc_e
        self._control_n, self._control_e = limit_lean(
            acc_n, acc_e, self._vel_n, self._vel_e, self._steepest_mps2
        )
        limited = acc_n != self._control_n or acc_e != self._control_e
        self._saturated = (acc_n, acc_e) if limited else None

    def _integrate(self, dt: float) -> None:
        """Integrate the velocity error; no longer than it is where the lean is at its limit.

        AC_PID_2D::update_i: nothing winds up while the vehicle cannot do what is asked of it.
        """
        gain = self.tuning.velocity_i * dt
        north, east = self._integral_n, self._integral_e
        longest = self.tuning.velocity_i_max_mps2
        beyond = self._saturated
        if beyond is not None and self._error_n * beyond[0] + self._error_e * beyond[1] > 0.0:
            longest = min(longest, sqrt(north * north + east * east))
        self._integral_n, self._integral_e = limit_length(
            north + self._error_n * gain, east + self._error_e * gain, longest
        )

    def _control_down(self) -> None:
        tuning = self.tuning
        limit = self.limits.vertical_acceleration_mps2
        error = self._pos_d - self.down_m - self._offset[2]
        self._gap_d = error
        wanted = self._vel_d + sqrt_controller(error, tuning.down_position_gain, limit)
        demand = tuning.down_velocity_p * (wanted - self.vd_mps) + self._acc_d
        self._lift_d += (demand - self._lift_d) * self._alpha_thrust

    def _turn(self, dt: float) -> None:
        """Yaw towards the command, or along the desired path (WP_YAW_BEHAVIOR 2)."""
        tuning, shaped = self.tuning, self._shaped_yaw
        speed = sqrt(self._vel_n * self._vel_n + self._vel_e * self._vel_e)
        error = 0.0
        if self._yaw_command is not None:
            error = wrap_pi(self._yaw_command - shaped.angle)
            self._yaw_command += self._yaw_command_rate * dt
        elif speed > LOOK_SHARE * self._speed_limit and self._mode != self._shape_hold:
            error = wrap_pi(atan2(self._vel_e, self._vel_n) - shaped.angle)
        turn = tuning.shaping.turn(
            error,
            shaped.rate,
            shaped.acceleration,
            self._yaw_command_rate,
            tuning.yaw_rate_rps,
            tuning.yaw_acceleration_rps2,
            tuning.yaw_input_s,
            dt,
        )
        shaped.move(turn, dt)
        behind = wrap_pi(shaped.angle - self.yaw_rad)
        wanted = shaped.rate + tuning.angle_gain * behind
        self.yawspeed_rps += (tuning.yaw_share * wanted - self.yawspeed_rps) * self._alpha_yaw
        self.yaw_rad = wrap_pi(self.yaw_rad + self.yawspeed_rps * dt)

    # ---- airframe

    def _move(self, dt: float) -> None:
        """Lean follows the wanted acceleration; velocity and position follow the lean.

        Each lag is driven by the mean of what it follows over the step, so that the length of the
        step adds no delay and takes none away.
        """
        north, east = _lean(self._control_n, self._control_e)
        self._shape_lean(self._shaped_n, north, dt)
        self._shape_lean(self._shaped_e, east, dt)
        step_n, step_e = self._roll_body(dt)
        vn, ve = self.vn_mps, self.ve_mps
        drag_n, drag_e = self._drag()
        push_n, push_e = _push(self._lean_n - 0.5 * step_n, self._lean_e - 0.5 * step_e)
        acc_n, acc_e = push_n - drag_n, push_e - drag_e
        # A climb's own drag is left to the loop of the vertical acceleration.
        acc_d = self._lift_d + self.tuning.drag_per_s * self.wind_ned_mps[2]
        self.north_m += (vn + 0.5 * acc_n * dt) * dt
        self.east_m += (ve + 0.5 * acc_e * dt) * dt
        self.down_m += (self.vd_mps + 0.5 * acc_d * dt) * dt
        self.vn_mps = vn + acc_n * dt
        self.ve_mps = ve + acc_e * dt
        self.vd_mps += acc_d * dt
        if self.down_m >= self.ground_down_m and self.vd_mps >= 0.0:
            self._touch_ground()

    def _shape_lean(self, shaped: _Shaped, wanted: float, dt: float) -> None:
        """Move one axis of the attitude target towards a lean, as the autopilot's limits allow."""
        lean = self.limits.lean
        turn = self.tuning.shaping.turn(
            wanted - shaped.angle,
            shaped.rate,
            shaped.acceleration,
            0.0,
            lean.rate_rps,
            lean.acceleration_rps2,
            lean.input_s,
            dt,
        )
        shaped.move(turn, dt)

    def _roll_body(self, dt: float) -> tuple[float, float]:
        """Lean by one step towards the shaped lean, which has just moved; the way gone, rad.

        The rate wanted is the shaped lean's own and the angle loop's correction; rate loop and
        motors follow it after a lag.
        """
        share, gain = self._alpha_rate, self.tuning.angle_gain
        shaped_n, shaped_e = self._shaped_n, self._shaped_e
        rate_n, rate_e = self._lean_rate_n, self._lean_rate_e
        want_n, want_e = shaped_n.rate, shaped_e.rate
        want_n += gain * (shaped_n.angle - 0.5 * want_n * dt - self._lean_n)
        want_e += gain * (shaped_e.angle - 0.5 * want_e * dt - self._lean_e)
        self._lean_rate_n = rate_n + (want_n - rate_n) * share
        self._lean_rate_e = rate_e + (want_e - rate_e) * share
        step_n = 0.5 * (rate_n + self._lean_rate_n) * dt
        step_e = 0.5 * (rate_e + self._lean_rate_e) * dt
        self._lean_n += step_n
        self._lean_e += step_e
        return step_n, step_e

    def _lean_at_once(self, north: float, east: float) -> None:
        """Lean so (rad), as if long since."""
        self._lean_n, self._lean_e = north, east
        self._lean_rate_n = self._lean_rate_e = 0.0
        self._shaped_n, self._shaped_e = _Shaped(north), _Shaped(east)

    def _drag(self) -> tuple[float, float]:
        """Deceleration by the air, north and east."""
        wind, tuning = self.wind_ned_mps, self.tuning
        north, east = self.vn_mps - wind[0], self.ve_mps - wind[1]
        rate = tuning.drag_per_s + tuning.drag_per_m * sqrt(north * north + east * east)
        return rate * north, rate * east

    def _lean_angles(self) -> None:
        """Roll and pitch (rad) whose thrust gives the horizontal acceleration, at this yaw."""
        sine, cosine = sin(self.yaw_rad), cos(self.yaw_rad)
        n, e = _push(self._lean_n, self._lean_e)
        rate_n, rate_e = self._lean_rate_n, self._lean_rate_e
        forward, right = n * cosine + e * sine, e * cosine - n * sine
        self.pitch_rad = -atan2(forward, GRAVITY_MPS2)
        self.roll_rad = atan2(right * cos(self.pitch_rad), GRAVITY_MPS2)
        self.pitchspeed_rps = -(rate_n * cosine + rate_e * sine)
        self.rollspeed_rps = rate_e * cosine - rate_n * sine

    def _touch_ground(self) -> None:
        """On the ground everything rests, except that a take-off in progress may still leave it."""
        self.down_m = self.ground_down_m
        self.vd_mps = 0.0
        if self._mode == self._shape_take_off:
            return
        self.landed = True
        self.vn_mps = self.ve_mps = 0.0
        self._lean_at_once(0.0, 0.0)
        self._control_n = self._control_e = 0.0
        self._lift_d = 0.0
        self.roll_rad = self.pitch_rad = 0.0
        self.rollspeed_rps = self.pitchspeed_rps = self.yawspeed_rps = 0.0
