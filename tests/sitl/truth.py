"""What a flight truly was: figures from the simulated positions, by the product's definitions."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pymap3d

from echowing.analysis.flight import Flight, Floats
from echowing.analysis.metrics import Metrics, metrics

from .vehicle import ORIGIN, State

RATE_HZ = 50.0


def track_ned_m(states: Sequence[State]) -> Floats:
    """NED metres about the origin, (n, 3)."""
    lat, lon, alt = (
        np.array([getattr(s, f"{axis}_{unit}") for s in states]) for axis, unit in _AXES
    )
    return np.column_stack(pymap3d.geodetic2ned(lat, lon, alt, *ORIGIN))


_AXES = (("lat", "deg"), ("lon", "deg"), ("alt", "m"))


def at_times(states: Sequence[State], times_s: Floats) -> Floats:
    """The track at these moments of our clock, (n, 3)."""
    heard_s = np.array([state.time_s for state in states])
    track = track_ned_m(states)
    return np.column_stack([np.interp(times_s, heard_s, track[:, axis]) for axis in range(3)])


def longest_gap_s(states: Sequence[State], since_s: float) -> float:
    """The longest time for which nothing was heard of where it is."""
    heard_s = [state.time_s for state in list(states) if state.time_s >= since_s]
    return float(np.max(np.diff(heard_s), initial=0.0))


def write(path: Path, states: Sequence[State]) -> None:
    """A track as a CSV: our clock, NED metres about the origin, the nose."""
    rows = list(states)
    if not rows:
        return
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("time_s", "north_m", "east_m", "down_m", "yaw_rad"))
        for state, place in zip(rows, track_ned_m(rows), strict=True):
            numbers = (state.time_s, *place, state.yaw_rad)
            table.writerow([f"{number:.3f}" for number in numbers])


def between(states: Sequence[State], from_s: float, to_s: float) -> list[State]:
    """The states of a part of the flight, and one more at each end."""
    return [state for state in list(states) if from_s - 0.1 <= state.time_s <= to_s + 0.1]


def flight(
    leader: Sequence[State],
    follower: Sequence[State],
    from_s: float,
    to_s: float,
    wanted_m: float,
) -> Flight:
    """A part of the flight on one clock, for `metrics`. The sonar's readings are not in it."""
    times_s = np.arange(from_s, to_s, 1.0 / RATE_HZ)
    ends = (at_times(between(one, from_s, to_s), times_s) for one in (leader, follower))
    leader_ned_m, follower_ned_m = ends
    unknown = np.full(len(times_s), np.nan)
    return Flight(
        name="truth",
        wanted_separation_m=wanted_m,
        time_s=times_s - from_s,
        leader_ned_m=leader_ned_m,
        leader_velocity_mps=np.gradient(leader_ned_m, 1.0 / RATE_HZ, axis=0),
        follower_ned_m=follower_ned_m,
        follower_velocity_mps=np.gradient(follower_ned_m, 1.0 / RATE_HZ, axis=0),
        follower_yaw_rad=unknown,
        slot_ned_m=np.full((len(times_s), 3), np.nan),
        sonar_m=unknown,
        speed_command_mps=unknown,
        pan_us=unknown,
        tilt_us=unknown,
        sonar_known=False,
    )


def figures(
    leader: Sequence[State],
    follower: Sequence[State],
    from_s: float,
    to_s: float,
    wanted_m: float,
) -> Metrics:
    """Separation and its error over a part of the flight."""
    return metrics(flight(leader, follower, from_s, to_s, wanted_m))


def body_frame(vector_ned_m: Floats, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Floats:
    """A vector in a vehicle's body frame: forward, right, down."""
    about_down, about_right, about_forward = (
        _rotation(axis, angle) for axis, angle in ((2, yaw_rad), (1, pitch_rad), (0, roll_rad))
    )
    return np.asarray(about_forward.T @ about_right.T @ about_down.T @ vector_ned_m)


def _rotation(axis: int, angle_rad: float) -> Floats:
    """Right-handed about one axis."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    before, after = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[before, before] = matrix[after, after] = cos
    matrix[before, after], matrix[after, before] = -sin, sin
    return matrix
