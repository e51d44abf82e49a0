"""Relay: a vehicle kept midway between a ground station and a remote vehicle. Pure.

After thesis Appendix D; flown by the same follow session as a formation, with the same guard.
"""

from echowing.errors import EchowingError
from echowing.flight.guidance import GuidanceSettings, GuidedPoint, LeaderFix, predicted
from echowing.flight.state import Guide
from echowing.geo import GlobalPosition, relay_pos

# Nothing here looks at the remote vehicle with a sonar, and nothing runs ahead of it.
RELAY_SETTINGS = GuidanceSettings(
    lead_time_s=0.0,
    keep_behind=False,
    face_leader=False,
    slot_rate_rps=None,
    learn_offset=False,
    feed_forward=False,
)


class RelayGuide(Guide):
    """Guided points midway to where the remote vehicle is believed to be now."""

    def __init__(self, ground: GlobalPosition) -> None:
        self._ground = ground

    def update(
        self,
        fix: LeaderFix,
        now_s: float,
        follower: GlobalPosition | None = None,
        least_radius_m: float = 0.0,
    ) -> GuidedPoint:
        """As `SlotGuide.update`; the place does not depend on where the relay is."""
        age_s = max(0.0, now_s - fix.time_s)
        remote = predicted(fix, age_s).position
        middle = relay_pos(self._ground, remote)
        return GuidedPoint(point=middle, slot=middle, leader=remote, yaw_rad=None, age_s=age_s)


def parse_ground(text: str) -> GlobalPosition:
    """`LAT,LON` in degrees. Raises EchowingError."""
    lat, comma, lon = text.partition(",")
    try:
        ground = GlobalPosition(float(lat), float(lon), 0.0)
    except ValueError:
        ground = None
    if (
        not comma
        or ground is None
        or not (abs(ground.lat_deg) <= 90 and abs(ground.lon_deg) <= 180)
    ):
        raise EchowingError(f"ground {text!r}: write LAT,LON in degrees, as 39.3400,-86.0300")
    return ground
