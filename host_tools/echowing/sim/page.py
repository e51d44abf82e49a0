"""A simulated world for the live page: the truth about everybody, as no real tool knows it."""

import math
from collections.abc import Iterator

from echowing.flight.guard import mode_name
from echowing.flight.guidance import MOVING_MPS, place_m
from echowing.flight.health import Cohesion
from echowing.geo import GlobalPosition, Ned, displace
from echowing.sim.aircraft import SimFollower, SimVehicle
from echowing.sim.flight import FormationWorld, speed_parameter_mps
from echowing.sim.vehicle.autopilot import ORIGIN
from echowing.tool.moment import Moment, members, places
from echowing.tool.panel import Row, VehicleHealth
from echowing.tool.run import Page
from echowing.tool.track import Track

SHOWN_EVERY = 5  # steps of 20 ms: 10 Hz
JUDGED_EVERY = 50


class WorldOnPage:
    """Shows a world as it is stepped, and says what its vehicles do."""

    def __init__(self, world: FormationWorld, page: Page) -> None:
        self._world, self._page = world, page
        self._sonar = world.scenario.sonar_belief
        self._cohesion = Cohesion(world.leader.autopilot.system_id, self._sonar)
        self._modes: dict[int, str] = {}
        self._steps = 0

    def step(self) -> None:
        """Step the world, and show it when it is time."""
        self._world.step()
        self._steps += 1
        if self._steps % SHOWN_EVERY:
            return
        for text in self._changes():
            self._page.event(self._world.t_s, text)
        moment = moment_of(self._world)
        if self._steps % JUDGED_EVERY == 0:
            vehicles = members(moment, places(moment, ORIGIN), self._sonar)
            for text in self._cohesion.update(vehicles, moment.time_s):
                self._page.event(moment.time_s, text)
        self._page.show(Moment(moment.time_s, moment.rows, moment.tracks, self._cohesion.health))

    def _changes(self) -> Iterator[str]:
        vehicles: list[SimVehicle] = [self._world.leader, *self._world.followers]
        for vehicle in vehicles:
            system_id, mode = vehicle.autopilot.system_id, _mode(vehicle)
            if self._modes.get(system_id) != mode:
                self._modes[system_id] = mode
                role = "leader" if vehicle is self._world.leader else "follower"
                yield f"{role} {system_id}: {mode}"


def moment_of(world: FormationWorld) -> Moment:
    """Where everybody truly is, and is to be behind where the leader truly is."""
    leader = world.leader
    formation, course_rad = world.slots(), _course_rad(leader)
    pairs = list(zip(world.followers, formation, strict=True))
    slots = [
        _slot(leader, place_m(formation, number, course_rad)[:2]) for number in range(len(pairs))
    ]
    return Moment(
        world.t_s,
        [_row(world, follower, world.watched(slot)) for follower, slot in pairs],
        [
            _track(leader, follower, at, slot.radius_m, slot.angle_rad, slot.altitude_step_m)
            for (follower, slot), at in zip(pairs, slots, strict=True)
        ],
    )


def _row(world: FormationWorld, follower: SimFollower, watched: SimVehicle) -> Row:
    leader = world.leader
    return Row(
        time_s=world.t_s,
        system_id=follower.autopilot.system_id,
        state="",
        separation_m=math.dist(watched.position_ned_m, follower.position_ned_m),
        error_m=None,
        slot_error_m=None,
        sonar_m=_range_m(follower, world.scenario.sonar_belief.reach_m),
        gimbal=None,
        leader_age_s=0.0,
        age_s=0.0,
        command_mps=speed_parameter_mps(follower.autopilot),
        speed_mps=math.hypot(*follower.velocity_ned_mps[:2]),
        leader_speed_mps=math.hypot(*leader.velocity_ned_mps[:2]),
        link_percent=None,
        north_offset_m=0.0,
        east_offset_m=0.0,
        own=VehicleHealth(mode=_mode(follower), altitude_m=-follower.position_ned_m[2]),
        leader=VehicleHealth(mode=_mode(leader)),
        watches=None if watched is leader else watched.autopilot.system_id,
    )


def _track(
    leader: SimVehicle,
    follower: SimFollower,
    slot: GlobalPosition,
    radius_m: float,
    angle_rad: float,
    step_m: float,
) -> Track:
    lead, own = _place(leader), _place(follower)
    return Track(
        wanted_radius_m=radius_m,
        wanted_angle_deg=math.degrees(angle_rad),
        wanted_step_m=step_m,
        leader_lat_deg=lead.lat_deg,
        leader_lon_deg=lead.lon_deg,
        leader_alt_m=lead.alt_m,
        leader_north_mps=leader.velocity_ned_mps[0],
        leader_east_mps=leader.velocity_ned_mps[1],
        leader_heading_deg=math.degrees(leader.body.yaw_rad) % 360.0,
        lat_deg=own.lat_deg,
        lon_deg=own.lon_deg,
        alt_m=own.alt_m,
        north_mps=follower.velocity_ned_mps[0],
        east_mps=follower.velocity_ned_mps[1],
        heading_deg=math.degrees(follower.body.yaw_rad) % 360.0,
        slot_lat_deg=slot.lat_deg,
        slot_lon_deg=slot.lon_deg,
        point_lat_deg=None,
        point_lon_deg=None,
        yaw_deg=None,
        pan_us=follower.coprocessor.pan_us,
        tilt_us=follower.coprocessor.tilt_us,
        leader_id=leader.autopilot.system_id,
        leader_height_m=-leader.position_ned_m[2],
        wanted_height_m=-leader.position_ned_m[2] + step_m,
    )


def _place(vehicle: SimVehicle) -> GlobalPosition:
    return displace(ORIGIN, vehicle.position_ned_m)


def _slot(leader: SimVehicle, offset_m: tuple[float, float]) -> GlobalPosition:
    north_m, east_m, down_m = leader.position_ned_m
    at_ned_m: Ned = (north_m + offset_m[0], east_m + offset_m[1], down_m)
    return displace(ORIGIN, at_ned_m)


def _course_rad(leader: SimVehicle) -> float:
    north_mps, east_mps, _ = leader.velocity_ned_mps
    if math.hypot(north_mps, east_mps) < MOVING_MPS:
        return leader.body.yaw_rad
    return math.atan2(east_mps, north_mps)


def _range_m(follower: SimFollower, reach_m: float) -> float | None:
    """What its sonar has read; out of its reach it is no target."""
    range_m = follower.sensor.last_range_m
    return None if range_m is None or range_m > reach_m else range_m


def _mode(vehicle: SimVehicle) -> str:
    mode = mode_name(vehicle.autopilot.modes.mode)
    return mode if vehicle.autopilot.modes.armed else f"{mode}, not armed"
