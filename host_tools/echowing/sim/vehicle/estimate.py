"""Where a body believes to be: its true position and the drift of its receiver."""

from echowing.geo import Ned


class EstimatedPosition:
    """The estimated position of anything that has a true one and an offset (NED metres)."""

    __slots__ = ("_offset",)

    north_m: float
    east_m: float
    down_m: float

    def __init__(self) -> None:
        self._offset: Ned = (0.0, 0.0, 0.0)

    def set_estimate_offset(self, offset_ned_m: Ned) -> None:
        """Let the estimated position be the true one plus this: GPS drift."""
        self._offset = offset_ned_m

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
