"""One flown pair on one clock: what the metrics, the table and the report are made from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from echowing.sonar_file import shipped_sonar

Floats = NDArray[np.float64]
SHIPPED_INSET_M = shipped_sonar().inset_m


@dataclass(frozen=True)
class Flight:
    """Time series of a leader and one follower, n samples on a common clock.

    Positions are local NED metres about one origin, velocities NED m/s. NaN is "no measurement".
    The simulator fills it from the truth, `analysis.logs` from what real logs hold.
    """

    name: str
    wanted_separation_m: float
    time_s: Floats  # (n,) rising
    leader_ned_m: Floats  # (n, 3)
    leader_velocity_mps: Floats  # (n, 3)
    follower_ned_m: Floats  # (n, 3)
    follower_velocity_mps: Floats  # (n, 3)
    follower_yaw_rad: Floats  # (n,)
    slot_ned_m: Floats  # (n, 3) where the follower should be: behind the leader's course
    sonar_m: Floats  # (n,) newest single reading; NaN: no target
    speed_command_mps: Floats  # (n,) the speed limit set by the applet; NaN: none set
    pan_us: Floats  # (n,) gimbal servo pulses; NaN: unknown
    tilt_us: Floats  # (n,)
    wanted_angle_rad: float = 0.0  # off the leader's tail, counter-clockwise positive
    law: str = ""
    seed: int | None = None
    source: str = "truth"  # "truth" (simulator) or "logs"
    sonar_known: bool = True  # False: no sonar was logged, which is not "it saw nothing"
    start_unix_s: float | None = None  # UTC of time_s = 0, where known
    # One line for each thing that could not be read or had to be guessed.
    warnings: tuple[str, ...] = ()
    # (n,) by positions that are corrected by what the ground tool had learnt of the receivers.
    estimated_m: Floats | None = None
    # How much less than the separation the sonar reads, as its applet is told (ECHO_INSET).
    sonar_inset_m: float = SHIPPED_INSET_M
    counted: NDArray[np.bool_] | None = None  # (n,) what the figures are made from; None: all
    left_out: tuple[str, ...] = ()  # what is not counted, each with its seconds

    @property
    def separation_m(self) -> Floats:
        """Distance leader to follower in three dimensions, (n,)."""
        return np.asarray(np.linalg.norm(self.follower_ned_m - self.leader_ned_m, axis=1))
