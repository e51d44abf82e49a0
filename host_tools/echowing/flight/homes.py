"""How high the vehicles' homes are, as each counts its altitude from its own. Pure."""

from typing import Any

from echowing.geo import GlobalPosition


class Homes:
    """The homes of one leader and its followers, by their receivers.

    level: they are known to be level, so what the receivers say of their difference is error;
    corrects: a follower flies higher by what its home is lower than the leader's.
    """

    def __init__(self, leader_id: int, *, level: bool = False, corrects: bool = False) -> None:
        self._leader_id = leader_id
        self._level, self._corrects = level, corrects
        self._above_sea_m: dict[int, float] = {}

    def reported(self, system_id: int, message: Any) -> None:
        """Take a vehicle's GLOBAL_POSITION_INT."""
        self._above_sea_m[system_id] = (message.alt - message.relative_alt) / 1e3

    def above_sea_m(self, system_id: int) -> float | None:
        """Altitude of a vehicle's home above sea level; None: not known."""
        return self._above_sea_m.get(system_id)

    def above_leaders_m(self, system_id: int) -> float | None:
        """How much higher than the leader's home a follower's is; None: one is not known."""
        own_m, leaders_m = self.above_sea_m(system_id), self.above_sea_m(self._leader_id)
        return None if own_m is None or leaders_m is None else own_m - leaders_m

    def shift_m(self, system_id: int) -> float:
        """What is added to the altitude of a follower above its home."""
        above_m = self.above_leaders_m(system_id) if self._corrects else None
        return 0.0 if above_m is None else -above_m

    def in_height(self, system_id: int, place: GlobalPosition) -> GlobalPosition:
        """A place to compare with others': its altitude above its home where homes are level.

        The receivers' difference between such homes is error, and would hide who is beside whom.
        """
        if not self._level:
            return place
        return place._replace(alt_m=place.alt_m - self._above_sea_m.get(system_id, 0.0))
