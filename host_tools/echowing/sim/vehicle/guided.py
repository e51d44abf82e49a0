"""Guided flight: sub-modes, the speed limit read once, pause, refused targets.

Semantics of ArduCopter/mode_guided.cpp: the limit is read from the speed parameter when a sub-mode
starts and at no other time; the limits of acceleration and jerk then, and whenever the speed is
set; a position target never times out; while paused, targets wait.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Protocol, runtime_checkable

from echowing.geo import Ned
from echowing.sim.vehicle.parameters import Parameters
from echowing.sim.vehicle.wpnav import TrackLimits


class Body(Protocol):
    """What the autopilot senses of its vehicle: metres, m/s, radians; local NED.

    The estimated position is where the vehicle believes to be.
    """

    north_m: float
    east_m: float
    down_m: float
    vn_mps: float
    ve_mps: float
    vd_mps: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rollspeed_rps: float
    pitchspeed_rps: float
    yawspeed_rps: float
    landed: bool

    @property
    def est_north_m(self) -> float:
        """Estimated north."""

    @property
    def est_east_m(self) -> float:
        """Estimated east."""

    @property
    def est_down_m(self) -> float:
        """Estimated down."""

    @property
    def est_vn_mps(self) -> float:
        """Estimated velocity north."""

    @property
    def est_ve_mps(self) -> float:
        """Estimated velocity east."""

    def set_estimate_offset(
        self, offset_ned_m: Ned, velocity_mps: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Estimated minus true position, and velocity (north, east)."""

    def estimate_reset(self, shift_ned_m: Ned) -> None:
        """The estimated position was moved by so much at once."""


@runtime_checkable
class Controls(Protocol):
    """What the autopilot can make its vehicle do (see `Copter`). Estimated frame."""

    def set_limits(self, limits: TrackLimits) -> None:
        """Keep these limits of acceleration, jerk and vertical speed from now on."""

    def start_guided(self, speed_limit_mps: float) -> None:
        """Start a sub-mode of Guided with this limit; 0: none."""

    def guided_position(self, target_ned_m: Ned, yaw_rad: float | None = None) -> None:
        """Fly to a position."""

    def guided_posvel(
        self,
        target_ned_m: Ned,
        velocity_ned_mps: Ned,
        yaw_rad: float | None = None,
        acceleration_ned_mps2: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> None:
        """Follow a moving point, whose velocity changes at an acceleration, and the yaw's rate."""

    def guided_velocity(self, velocity_ned_mps: Ned, yaw_rad: float | None = None) -> None:
        """Fly at a velocity."""

    def set_speed_limit(self, speed_mps: float) -> None:
        """Limit the speed; 0: no limit."""

    def start_auto(self, waypoints_ned_m: Sequence[Ned], speed_mps: float) -> None:
        """Fly a mission."""

    def hold(self) -> None:
        """Brake and stay."""

    def land(self) -> None:
        """Descend to the ground."""

    def take_off(self, altitude_m: float) -> None:
        """Climb to a height above the ground."""


class SubMode(IntEnum):
    """Numbers as in ArduCopter/mode.h; GUIP in the dataflash log shows them."""

    TAKE_OFF = 0
    POSITION = 2
    POSITION_VELOCITY = 3
    VELOCITY = 4


class Guided:
    """The Guided mode of one vehicle.

    `within_fence` judges a target (estimated NED); `log` is told every target taken: sub-mode,
    position, velocity.
    """

    def __init__(
        self,
        controls: Controls,
        parameters: Parameters,
        within_fence: Callable[[Ned], bool],
        log: Callable[[SubMode, Ned, Ned], None],
    ) -> None:
        self._controls = controls
        self._parameters = parameters
        self._within_fence = within_fence
        self._log = log
        self.sub_mode = SubMode.VELOCITY
        self.limit_mps = 0.0
        self.paused = False
        self.target_ned_m: Ned | None = None
        """The position target in force; None in sub-modes that keep none."""
        self.velocity_ned_mps: Ned = (0.0, 0.0, 0.0)
        """The velocity target in force, 0 without one."""
        self._act: Callable[[], None] | None = None

    def start(self) -> None:
        """Enter the mode, or stop after an invalid target: brakes, and the limit is read anew."""
        self.paused = False
        self._act = None
        self._aim(None, (0.0, 0.0, 0.0))
        self._begin(SubMode.VELOCITY)

    def position(self, target: Ned, yaw_rad: float | None = None) -> bool:
        """Fly to a position; False: outside the fence, and the former target stays."""
        if not self._within_fence(target):
            return False
        self._switch(SubMode.POSITION)
        self._aim(target, (0.0, 0.0, 0.0))
        self._log(self.sub_mode, target, (0.0, 0.0, 0.0))
        self._do(lambda: self._controls.guided_position(target, yaw_rad))
        return True

    def position_velocity(
        self,
        target: Ned,
        velocity: Ned,
        yaw_rad: float | None = None,
        acceleration: Ned = (0.0, 0.0, 0.0),
        yaw_rate_rps: float = 0.0,
    ) -> bool:
        """Follow a moving point; False as for `position`."""
        if not self._within_fence(target):
            return False
        self._switch(SubMode.POSITION_VELOCITY)
        self._aim(None, velocity)
        self._log(self.sub_mode, target, velocity)
        self._do(
            lambda: self._controls.guided_posvel(
                target, velocity, yaw_rad, acceleration, yaw_rate_rps
            )
        )
        return True

    def velocity(self, velocity: Ned, yaw_rad: float | None = None) -> None:
        """Fly at a velocity; it times out (GUID_TIMEOUT)."""
        self._switch(SubMode.VELOCITY)
        self._aim(None, velocity)
        self._log(self.sub_mode, (0.0, 0.0, 0.0), velocity)
        self._do(lambda: self._controls.guided_velocity(velocity, yaw_rad))

    def take_off(self, altitude_m: float) -> None:
        """Climb to a height above the ground."""
        self.sub_mode = SubMode.TAKE_OFF
        self._aim(None, (0.0, 0.0, 0.0))
        self._do(lambda: self._controls.take_off(altitude_m))

    def set_speed(self, speed_mps: float) -> None:
        """Limit the speed until the next sub-mode starts; 0: no limit."""
        self.limit_mps = speed_mps
        if not self.paused:
            self._controls.set_limits(self._parameters.motion_limits())
            self._controls.set_speed_limit(speed_mps)

    def pause(self) -> None:
        """Brake; what is commanded from now on waits."""
        self.paused = True
        self._controls.hold()

    def resume(self) -> None:
        """Go on with the newest target and the limit in force."""
        self.paused = False
        self._controls.start_guided(self.limit_mps)
        if self._act is not None:
            self._act()

    def _aim(self, target: Ned | None, velocity: Ned) -> None:
        self.target_ned_m = target
        self.velocity_ned_mps = velocity

    def _switch(self, sub_mode: SubMode) -> None:
        if self.sub_mode is not sub_mode:
            self._begin(sub_mode)

    def _begin(self, sub_mode: SubMode) -> None:
        self.sub_mode = sub_mode
        self.limit_mps = self._parameters.speed_mps()
        if not self.paused:
            self._controls.set_limits(self._parameters.motion_limits())
            self._controls.start_guided(self.limit_mps)

    def _do(self, act: Callable[[], None]) -> None:
        self._act = act
        if not self.paused:
            act()
