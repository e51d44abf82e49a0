"""Lua instructions of the applet per update, as figures for its doc.

    .venv/bin/python -m tests.lua.measure

Each situation is flown on a vehicle on the desk with the instruction counter on: it counts the
applet's own instructions; what ArduPilot does in C costs one each. For the memory see heap.py.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from tests.lua.conftest import mavlink_frame

from echowing.mavlink.messages import POINT_FORMAT
from echowing.paths import lua_folder
from echowing.sim.vehicle.desk import GOOD, DeskVehicle
from echowing.sim.vehicle.luahost import LuaHost
from echowing.sim.vehicle.parameters import Generation

STEP_MS = 10
POSITION_VELOCITY = 0x0DC0  # type mask of the tool's points without a yaw


def new_vehicle() -> DeskVehicle:
    """Enabled, armed, in Guided, leader in sight at 3 m."""
    vehicle = DeskVehicle({"WP_SPD": 10.0, "MAV_SYSID": 1.0, "RNGFND1_TYPE": 10.0})
    vehicle.parameters.update(RNGFND1_ORIENT=0.0, ECHO_ENABLE=1.0)
    vehicle.ranges[0] = (GOOD, 3.0)
    return vehicle


def feed(vehicle: DeskVehicle, range_m: float, velocity_mps: float) -> None:
    """A single reading every 50 ms and a guided point every 120 ms."""
    if vehicle.t_ms % 50 == 0:
        vehicle.ranges[0] = (GOOD, range_m)
        vehicle.inbox.append(
            (mavlink_frame(251, struct.pack("<If10s", vehicle.t_ms, range_m, b"SNR_RAW"), 1), 1)
        )
    if vehicle.t_ms % 120 == 0:
        rest = (velocity_mps, 0.0, 0.0, 0.0, 0.0, POINT_FORMAT, 0.0, 0.0)
        fields = (0, 393400300, -860300000, 10.0, *rest, POSITION_VELOCITY, 1, 1, 6)
        vehicle.inbox.append((mavlink_frame(86, struct.pack("<Iii9fHBBB", *fields), 245), 0))


def most(range_m: Callable[[float], float], velocity_mps: float) -> tuple[int, int]:
    """Most instructions of the start and of any update in 20 s."""
    vehicle = new_vehicle()
    host = LuaHost(
        vehicle,
        lua_folder() / "echowing.lua",
        generation=Generation.V4_8,
        count_instructions=True,
    )
    host.step(0)
    start, worst = host.instructions, 0
    host.instructions = 0
    for _ in range(2000):
        vehicle.t_ms += STEP_MS
        feed(vehicle, range_m(vehicle.t_ms / 1000.0), velocity_mps)
        host.step(vehicle.t_ms)
        worst = max(worst, host.instructions)
    if host.error is not None:
        raise SystemExit(host.error)
    return start, worst


def main() -> None:
    """Print one line a situation."""
    situations: list[tuple[str, Callable[[float], float], float]] = [
        ("stopped by the tool", lambda t: 3.0, 0.0),
        ("leader closing", lambda t: max(0.3, 4.0 - t % 4.0), 0.0),
        ("holding", lambda t: 3.0, 1.0),
    ]
    for name, range_m, velocity_mps in situations:
        start, worst = most(range_m, velocity_mps)
        print(f"{name:24} start {start:5d}, update {worst:5d} of 10000")


if __name__ == "__main__":
    main()
