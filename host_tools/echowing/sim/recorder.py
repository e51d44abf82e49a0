"""The truth of a simulated flight, one row every 100 ms, and what is made from it."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from echowing.analysis.flight import Flight, Floats
from echowing.flight.guidance import Slot, slot_offset_m
from echowing.geo import Ned
from echowing.sim.vehicle.streams import START_UNIX_S

TRUTH_COLUMNS = (
    "unix_time_s",
    "separation_m",
    "slot_error_m",
    "follower_speed_mps",
    "leader_speed_mps",
    "leader_north_m",
    "leader_east_m",
    "leader_down_m",
    "follower_north_m",
    "follower_east_m",
    "follower_down_m",
    "sonar_m",
    "speed_command_mps",
    "pan_us",
    "tilt_us",
)


@dataclass(slots=True)
class Sample:
    """Everything true about one pair at one moment. NED metres and m/s; None: nothing."""

    time_s: float
    leader: Ned
    leader_velocity: Ned
    leader_course_rad: float
    follower: Ned
    follower_velocity: Ned
    follower_yaw_rad: float
    sonar_m: float | None
    speed_command_mps: float | None
    pan_us: float
    tilt_us: float


@dataclass
class Recorder:
    """Collects the samples of one follower."""

    name: str
    slot: Slot
    law: str
    seed: int
    samples: list[Sample] = field(default_factory=list)

    def flight(self) -> Flight:
        """The samples as time series."""
        samples = self.samples
        leader = np.array([s.leader for s in samples])
        courses = np.array([s.leader_course_rad for s in samples])
        return Flight(
            name=self.name,
            wanted_separation_m=math.hypot(self.slot.radius_m, self.slot.altitude_step_m),
            wanted_angle_rad=self.slot.angle_rad,
            law=self.law,
            seed=self.seed,
            start_unix_s=float(START_UNIX_S),
            time_s=np.array([s.time_s for s in samples]),
            leader_ned_m=leader,
            leader_velocity_mps=np.array([s.leader_velocity for s in samples]),
            follower_ned_m=np.array([s.follower for s in samples]),
            follower_velocity_mps=np.array([s.follower_velocity for s in samples]),
            follower_yaw_rad=np.array([s.follower_yaw_rad for s in samples]),
            slot_ned_m=leader + self._offsets(courses),
            sonar_m=_or_nan([s.sonar_m for s in samples]),
            speed_command_mps=_or_nan([s.speed_command_mps for s in samples]),
            pan_us=np.array([s.pan_us for s in samples]),
            tilt_us=np.array([s.tilt_us for s in samples]),
        )

    def _offsets(self, courses: Floats) -> Floats:
        offsets = np.array([slot_offset_m(self.slot, float(course)) for course in courses])
        down = np.full(len(courses), -self.slot.altitude_step_m)
        return np.column_stack([offsets, down])


def _or_nan(values: Sequence[float | None]) -> Floats:
    return np.array([math.nan if value is None else value for value in values])


def write_truth(path: Path, flight: Flight) -> None:
    """truth.csv: what no real log knows, to compare an analysis with."""
    slot_error = np.hypot(*(flight.follower_ned_m - flight.slot_ned_m)[:, :2].T)
    columns = [
        START_UNIX_S + flight.time_s,
        flight.separation_m,
        slot_error,
        np.hypot(*flight.follower_velocity_mps[:, :2].T),
        np.hypot(*flight.leader_velocity_mps[:, :2].T),
        *flight.leader_ned_m.T,
        *flight.follower_ned_m.T,
        flight.sonar_m,
        flight.speed_command_mps,
        flight.pan_us,
        flight.tilt_us,
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(TRUTH_COLUMNS)
        writer.writerows([f"{value:.3f}" for value in row] for row in zip(*columns, strict=True))
