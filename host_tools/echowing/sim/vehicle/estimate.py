"""Where a body believes to be: its true position and velocity and the errors of its receiver."""

from echowing.geo import Ned


class EstimatedPosition:
    """The estimated motion of anything that has a true one and is off by so much.

    Its vertical speed is taken for right.
    """

    __slots__ = ("_offset", "_velocity_offset")

    north_m: float
    east_m: float
    down_m: float
    vn_mps: float
    ve_mps: float

    def __init__(self) -> None:
        self._offset: Ned = (0.0, 0.0, 0.0)
        self._velocity_offset = (0.0, 0.0)

    def set_estimate_offset(
        self, offset_ned_m: Ned, velocity_mps: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Let the estimate be the truth plus this: NED metres, and (north, east)."""
        self._offset, self._velocity_offset = offset_ned_m, velocity_mps

    def estimate_reset(self, shift_ned_m: Ned) -> None:
        """The filter has moved its estimate by so much at once; who controls nothing goes on."""

    @property
    def est_north_m(self) -> float:
        """Estimated north, metres."""
        return self.north_m + self._offset[0]

    @property
    def est_east_m(self) -> float:
        """Estimated east, metres."""
        return self.east_m + self._offset[1]

    @property
    def est_down_m(self) -> float:
        """Estimated down, metres."""
        return self.down_m + self._offset[2]

    @property
    def est_vn_mps(self) -> float:
        """Estimated velocity north."""
        return self.vn_mps + self._velocity_offset[0]

    @property
    def est_ve_mps(self) -> float:
        """Estimated velocity east."""
        return self.ve_mps + self._velocity_offset[1]
