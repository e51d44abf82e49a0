"""Where a follower flies by its orders, until its next report shows it. Pure.

Over two telemetry radios a follower's report and the order that answers it are a second apart.
If a report is carried on at its velocity alone, a follower that has stopped since seems to fly on:
it is ordered back, and then forth, without end. The orders sent meanwhile are known here, so a
report is carried on as Guided answers the orders that reach it.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from echowing.flight.closing import Closing
from echowing.flight.guidance import Horizontal, between
from echowing.geo import GlobalPosition, ned_between

# Up to NOT_YET_S after a report its velocity already shows what orders have changed; from ALL_S on
# (the lean, and the acceleration that builds up) only the orders count.
NOT_YET_S, ALL_S = 0.3, 0.6
# Reports are carried on for two seconds at the most; an order may be in force from before.
REMEMBERED_S = 5.0
STEP_S = 0.1
# From an order's arrival until the velocity changes: the motors' time. The lean takes 0.2 s more,
# but Guided's own plan is 0.2 s ahead of the velocity in the report. Over 2,000 predictions
# with both radios 0.46 s (ArduCopter 4.8 and 4.6 in the simulator) 0.1 s is 0.1 m better than 0.5.
BEGINS_S = 0.1


@dataclass(frozen=True, slots=True)
class _Order:
    """A place that moves at a velocity, (north, east), from `time_s` on; flown from `begins_s` on.

    Metres from the first order's place.
    """

    time_s: float
    begins_s: float
    place_m: Horizontal
    velocity_mps: Horizontal
    closing: Closing

    def asks_mps(self, at_m: Horizontal, time_s: float) -> Horizontal:
        """The velocity with which Guided answers it."""
        since_s = time_s - self.time_s
        north, east = self.velocity_mps
        north_m = self.place_m[0] + north * since_s - at_m[0]
        east_m = self.place_m[1] + east * since_s - at_m[1]
        pace = self.closing.pace_per_s(math.hypot(north_m, east_m))
        return north + pace * north_m, east + pace * east_m


class OwnMotion:
    """The orders sent to a follower lately."""

    def __init__(self) -> None:
        self._orders: deque[_Order] = deque()
        self._origin: GlobalPosition | None = None

    def forget(self) -> None:
        """Drop the orders: it does not fly by ours now."""
        self._orders.clear()
        self._origin = None

    def ordered(
        self, arrives_s: float, place: GlobalPosition, velocity_mps: Horizontal, closing: Closing
    ) -> None:
        """Take an order to fly to a place that moves (north, east), and when it arrives."""
        self._origin = self._origin or place
        place_m = ned_between(self._origin, place)[:2]
        begins_s = arrives_s + BEGINS_S
        self._orders.append(_Order(arrives_s, begins_s, place_m, velocity_mps, closing))
        while self._orders[0].begins_s < arrives_s - REMEMBERED_S:
            self._orders.popleft()

    def carried_on(
        self, place: GlobalPosition, velocity_mps: Horizontal, since_s: float, to_s: float
    ) -> tuple[Horizontal, Horizontal]:
        """By how much it moves from a place, and its velocity then, (north, east) each."""
        to_s = min(to_s, since_s + REMEMBERED_S)
        span_s = to_s - since_s
        straight_m = velocity_mps[0] * span_s, velocity_mps[1] * span_s
        share = min(1.0, (span_s - NOT_YET_S) / (ALL_S - NOT_YET_S))
        orders = self._in_force(since_s, to_s) if share > 0.0 else []
        if not orders or self._origin is None:
            return straight_m, velocity_mps
        begin_m = ned_between(self._origin, place)[:2]
        moved_m, flown_mps = self._answered(orders, begin_m, velocity_mps, since_s, to_s)
        return between(straight_m, moved_m, share), between(velocity_mps, flown_mps, share)

    def _answered(
        self,
        orders: list[_Order],
        begin_m: Horizontal,
        velocity_mps: Horizontal,
        since_s: float,
        to_s: float,
    ) -> tuple[Horizontal, Horizontal]:
        """`carried_on` by Guided's answer to these orders; begin_m: from the first one's place."""
        moved_m, flown_mps = (0.0, 0.0), velocity_mps
        for order, time_s, step_s in _steps(orders, since_s, to_s):
            before_mps = flown_mps
            if order is not None:
                at_m = begin_m[0] + moved_m[0], begin_m[1] + moved_m[1]
                asked_mps = order.asks_mps(at_m, time_s)
                flown_mps = _turned(flown_mps, asked_mps, order.closing, step_s)
            moved_m = _moved(moved_m, before_mps, flown_mps, step_s)
        return moved_m, flown_mps

    def _in_force(self, since_s: float, to_s: float) -> list[_Order]:
        """The orders that are flown between two moments, the first perhaps from before."""
        orders: list[_Order] = []
        for order in reversed(self._orders):
            if order.begins_s >= to_s:
                continue
            orders.append(order)
            if order.begins_s <= since_s:
                break
        return orders[::-1]


def _steps(
    orders: list[_Order], since_s: float, to_s: float
) -> Iterator[tuple[_Order | None, float, float]]:
    """The order in force (None: none yet), a step's beginning and its length, in turn."""
    order, time_s = None, since_s
    for following in (*orders, None):
        until_s = to_s if following is None else following.begins_s
        while time_s < until_s:
            step_s = min(STEP_S, until_s - time_s)
            yield order, time_s, step_s
            time_s += step_s
        order = following


def _moved(by_m: Horizontal, a_mps: Horizontal, b_mps: Horizontal, span_s: float) -> Horizontal:
    share_s = 0.5 * span_s
    return by_m[0] + (a_mps[0] + b_mps[0]) * share_s, by_m[1] + (a_mps[1] + b_mps[1]) * share_s


def _turned(
    from_mps: Horizontal, to_mps: Horizontal, closing: Closing, step_s: float
) -> Horizontal:
    """A velocity changed towards another for `step_s`, as Guided does."""
    north, east = to_mps[0] - from_mps[0], to_mps[1] - from_mps[1]
    off_mps = max(math.hypot(north, east), 1e-9)
    share = step_s * min(closing.turns_per_s, closing.accel_mps2 / off_mps)
    return from_mps[0] + share * north, from_mps[1] + share * east
