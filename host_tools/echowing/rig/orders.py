"""Orders where to look, as a MAVLink gimbal device takes them, and the directions in them."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.rig.bench import POLL_S, Bench

# A new order is told ten times a second, as in flight; it counts for one second.
ORDER_PERIOD_S = 0.1

EARTH_FRAME = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
)


@dataclass(frozen=True)
class Direction:
    """Degrees: to the right of north, or of straight ahead; and up."""

    right_deg: float
    up_deg: float

    def apart_deg(self, other: "Direction") -> float:
        """Angle between the two."""
        (ax, ay, az), (bx, by, bz) = self._vector(), other._vector()
        return math.degrees(math.acos(max(-1.0, min(1.0, ax * bx + ay * by + az * bz))))

    def _vector(self) -> tuple[float, float, float]:
        right, up = math.radians(self.right_deg), math.radians(self.up_deg)
        return math.cos(up) * math.cos(right), math.cos(up) * math.sin(right), math.sin(up)

    def quaternion(self) -> list[float]:
        """The rotation to it, w x y z."""
        yaw, pitch = math.radians(self.right_deg) / 2.0, math.radians(self.up_deg) / 2.0
        return [
            math.cos(yaw) * math.cos(pitch),
            -math.sin(yaw) * math.sin(pitch),
            math.cos(yaw) * math.sin(pitch),
            math.sin(yaw) * math.cos(pitch),
        ]


def looked(q: Sequence[float]) -> Direction:
    """Where a rotation w x y z turns straight ahead."""
    w, x, y, z = q
    forward, right = w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)
    up = 2.0 * (w * y - x * z)
    return Direction(
        math.degrees(math.atan2(right, forward)),
        math.degrees(math.atan2(up, math.hypot(forward, right))),
    )


class Orders:
    """The orders to one board, told again and again."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._told_s = -math.inf

    def at_once(self) -> None:
        """The next order goes out now, not when it is due."""
        self._told_s = -math.inf

    def hold(self, order: Direction, seconds: float) -> Iterator[Any]:
        """The board's messages while it is told to look there."""
        return self.follow(lambda _: order, seconds)

    def follow(
        self,
        path: Callable[[float], Direction],
        seconds: float,
        *,
        right_dps: float = 0.0,
        up_dps: float = 0.0,
    ) -> Iterator[Any]:
        """The board's messages while it is told to look along a path, over the seconds since now.

        right_dps, up_dps: how the path moves; the board carries each order on by it.
        """
        bench = self._bench
        begun_s = bench.clock()
        while (now_s := bench.clock()) < begun_s + seconds:
            if now_s - self._told_s >= ORDER_PERIOD_S:
                self._told_s = now_s
                self._send(path(now_s - begun_s), EARTH_FRAME, right_dps, up_dps)
            yield from bench.heard(min(POLL_S, begun_s + seconds - now_s))

    def end(self, order: Direction) -> None:
        """The board does again as without orders."""
        self._send(order, mavlink.GIMBAL_DEVICE_FLAGS_RETRACT, 0.0, 0.0)

    def _send(self, order: Direction, flags: int, right_dps: float, up_dps: float) -> None:
        board = self._bench.board
        rates = (0.0, math.radians(up_dps), math.radians(right_dps))
        board.send(
            mavlink.MAVLink_gimbal_device_set_attitude_message(
                board.system_id, board.component_id, flags, order.quaternion(), *rates
            )
        )
