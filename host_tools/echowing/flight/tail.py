"""Gray's slot: fixed to the leader's tail, on its course as it is reported (thesis 3.4.1). Pure."""

from echowing.flight.guidance import Course, GuidedPoint, Horizontal, LeaderFix, Slot, at_slot
from echowing.geo import GlobalPosition


class TailSlot:
    """The slot of one follower; swings round with the leader's course, however fast that turns."""

    def __init__(self, slot: Slot) -> None:
        self.slot = slot
        self._course = Course()

    def place(self, slot: Slot, bar_m: float) -> None:
        """As `TowBar.place`."""
        self.slot = slot

    def update(
        self,
        leader: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
        formation_mps: Horizontal | None = None,
    ) -> GuidedPoint:
        """As `TowBar.update`; only the leader changes anything."""
        return at_slot(self.slot, leader, self._course.update(leader), follower)
