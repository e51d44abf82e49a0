"""Gray's slot: fixed to the leader's tail, on its course as it is reported (thesis 3.4.1). Pure."""

from echowing.flight.guidance import (
    Course,
    GuidedPoint,
    LeaderFix,
    Slot,
    bearing_rad,
    slot_offset_m,
)
from echowing.geo import GlobalPosition, displace


class TailSlot:
    """The slot of one follower; swings round with the leader's course, however fast that turns."""

    def __init__(self, slot: Slot) -> None:
        self.slot = slot
        self._course = Course()

    def place(self, slot: Slot, longest_m: float) -> None:
        """As `TowBar.place`."""
        self.slot = slot

    def update(
        self,
        leader: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
    ) -> GuidedPoint:
        """As `TowBar.update`; neither the follower nor a least radius changes anything."""
        course_rad = self._course.update(leader)
        offset_m = slot_offset_m(self.slot, course_rad)
        place = displace(leader.position, (*offset_m, -self.slot.altitude_step_m))
        return GuidedPoint(
            point=place,
            slot=place,
            leader=leader.position,
            yaw_rad=bearing_rad(follower or place, leader.position),
            offset_m=offset_m,
            velocity_mps=leader.velocity_ned_mps[:2],
            course_rad=course_rad,
        )
