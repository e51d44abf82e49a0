"""A scenario's world in real time for other tools: vehicles in the air, nobody on the ground."""

import shlex
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import tomli_w

from echowing.errors import EchowingError
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import check_formation, receivers_demand_m
from echowing.flight.reshape import check_changes
from echowing.geo import Ned
from echowing.paths import SHIPPED_SONAR
from echowing.sim.aircraft import LeaderPilot, SimFollower, SimVehicle
from echowing.sim.flight import FormationWorld
from echowing.sim.ground import TELEMETRY
from echowing.sim.hangar import Hangar
from echowing.sim.page import WorldOnPage
from echowing.sim.parked import ParkedHangar, ParkedWorld, insert_cards
from echowing.sim.scenario import Scenario
from echowing.sim.serve import Endpoint, Server
from echowing.sim.vehicle.guided import SubMode
from echowing.sim.vehicle.modes import GUIDED
from echowing.sim.world.cutter import PacketCutter
from echowing.stopping import stop_on_signals
from echowing.tool.formation_file import SHAPE_KEYS, FormationSection
from echowing.tool.run import Page

# Ports of one vehicle, as SITL lays them out: the next vehicle 10 on, a second link 2 on.
VEHICLE_PORTS = 10
PILOT_PORT = 2
PILOT_LINK = "pilot"
HIGHEST_PORT = 65_535
STARTS = "The leader starts to fly when follow sends the first points."
LED = (SubMode.POSITION, SubMode.POSITION_VELOCITY)
# Of a slot of a scenario, what `follow --formation` needs.
PLACE = {"radius_m", "angle_deg", "altitude_step_m", "behind"}


class WaitingPilot(LeaderPilot):
    """The leader's pilot, who sets out when the first follower flies to points in Guided."""

    def __init__(self, world: FormationWorld) -> None:
        super().__init__(world.leader, world.scenario.leader)
        self._followers = world.followers
        self._since_s: float | None = None

    def step(self, t_s: float, follower: Ned) -> None:
        """As `LeaderPilot.step`, counted from when he set out."""
        if self._since_s is None and any(map(_is_led, self._followers)):
            self._since_s = t_s
        if self._since_s is not None:
            super().step(t_s - self._since_s, follower)


def _is_led(follower: SimFollower) -> bool:
    modes = follower.autopilot.modes
    return modes.mode == GUIDED and modes.guided.sub_mode in LED


class LossyEndpoint:
    """A vehicle's endpoint whose telemetry radio loses bytes, to it (`up`) and from it (`down`)."""

    def __init__(self, endpoint: Endpoint, down: PacketCutter, up: PacketCutter) -> None:
        self._endpoint = endpoint
        self._down, self._up = down, up

    def receive(self, link: str, data: bytes) -> None:
        """Bytes off the wire."""
        if link == TELEMETRY:
            data = self._up.carry(data, time.monotonic())
        self._endpoint.receive(link, data)

    def transmit(self, link: str) -> bytes:
        """Bytes to go on the wire."""
        data = self._endpoint.transmit(link)
        return self._down.carry(data, time.monotonic()) if link == TELEMETRY else data


class SilencedLeader:
    """The leader's endpoint, whose radio the scenario may silence."""

    def __init__(self, endpoint: Endpoint, pilot: LeaderPilot) -> None:
        self._endpoint = endpoint
        self._pilot = pilot

    def receive(self, link: str, data: bytes) -> None:
        """Bytes off the wire."""
        self._endpoint.receive(link, data)

    def transmit(self, link: str) -> bytes:
        """Bytes to go on the wire; lost while the radio is dead."""
        data = self._endpoint.transmit(link)
        return b"" if self._pilot.silent and link == TELEMETRY else data


def serve(
    scenario: Scenario,
    seed: int,
    port: int,
    signing_key: bytes | None = None,
    *,
    parked: bool = False,
    cards: Path | None = None,
    page: Page | None = None,
) -> int:
    """Fly `scenario` in real time until Ctrl-C or SIGTERM; returns the exit code.

    With `parked` its vehicles stand on the ground instead, as they come from the factory. `cards`
    is a folder for the SD cards of the followers, each in a folder named by its system id.

    The leader's telemetry is on TCP `port` of this machine, each follower's 10 further on, and a
    second link of each vehicle, for the pilot's own ground station, 2 above its first. With a key
    the telemetry is signed; the second link stays unsigned, as a vehicle's USB does. `page` shows
    the truth in a browser.
    Raises EchowingError for a port or a folder that cannot be had.
    """
    if scenario.kind != "formation":
        raise EchowingError(f"--serve: scenario {scenario.name} has no leader and followers")
    if scenario.swarm.followers:
        raise EchowingError("--serve: a swarm is for simulated flights: `follow` leads slots only")
    if scenario.plan is not None:
        raise EchowingError("--serve: `follow` flies by its own plan: remove yours")
    if scenario.fault:
        raise EchowingError(f"--serve: the faults of {scenario.name} are flown without it only")
    _check_ports(port, 1 + len(scenario.slots()))
    world = _world(scenario, seed, parked=parked)
    if cards is not None:
        insert_cards(world.followers, cards)
    step = world.step if page is None else WorldOnPage(world, page).step
    with closing(Server(lambda t_s: step())) as server, stop_on_signals() as stop:
        _connect(server, world, port)
        if signing_key is not None:
            for vehicle in (world.leader, *world.followers):
                vehicle.autopilot.sign_link(TELEMETRY, signing_key)
        say_how_to_go_on(scenario, port, parked=parked, signed=signing_key is not None)
        if page is not None:
            print(page.said, flush=True)
        server.run(stop)
    print("stopped", flush=True)
    return 0


def _world(scenario: Scenario, seed: int, *, parked: bool) -> FormationWorld:
    if parked:
        return ParkedWorld(scenario, ParkedHangar(scenario, seed))
    world = FormationWorld(scenario, Hangar(scenario, seed))
    world.pilot = WaitingPilot(world)
    return world


def _check_ports(port: int, vehicles: int) -> None:
    highest = HIGHEST_PORT - VEHICLE_PORTS * (vehicles - 1) - PILOT_PORT
    if not 1 <= port <= highest:
        raise EchowingError(f"--serve {port}: {vehicles} vehicles need a port from 1 to {highest}")


def _connect(server: Server, world: FormationWorld, port: int) -> None:
    vehicles: list[SimVehicle] = [world.leader, *world.followers]
    for index, vehicle in enumerate(vehicles):
        autopilot = vehicle.autopilot
        leads = vehicle is world.leader
        heard: Endpoint = SilencedLeader(autopilot, world.pilot) if leads else autopilot
        radio = world.scenario.radio.leader if leads else world.scenario.radio.follower
        endpoint = LossyEndpoint(heard, *world.hangar.cutters(f"served {index}", radio))
        for link, shift in ((TELEMETRY, 0), (PILOT_LINK, PILOT_PORT)):
            autopilot.add_link(link)
            server.connect(endpoint, link, f"tcpin:{port + VEHICLE_PORTS * index + shift}")
    for index, vehicle in enumerate(vehicles):
        here = port + VEHICLE_PORTS * index
        role = "follower" if index else "leader"
        print(
            f"{role:<8}  system {vehicle.autopilot.system_id:<3}  tcp:127.0.0.1:{here}"
            f"  (the pilot's own ground station: tcp:127.0.0.1:{here + PILOT_PORT})",
            flush=True,
        )


def say_how_to_go_on(
    scenario: Scenario, port: int, *, parked: bool = False, signed: bool = False
) -> None:
    """Print the commands for another terminal."""
    followers = [f"tcp:127.0.0.1:{port + VEHICLE_PORTS * (1 + i)}" for i in _indices(scenario)]
    key = " --signing-key-file FILE" if signed else ""
    if parked:
        print("Nothing is set up on them. In another terminal, for each follower:")
        sensor = _sonar(scenario) if scenario.sonar_file.fixed else " --serial 2"
        for follower in followers:
            print(f"  echowing setup apply --vehicle {follower}{sensor} --restart{key}")
        print("", end="", flush=True)
        return
    ends = " ".join(f"--follower {follower}" for follower in followers)
    leader = f"--leader tcp:127.0.0.1:{port}"
    print("To fly the formation, in another terminal:")
    told = f"{_places(scenario, port)}{_beliefs(scenario)}{_chained(scenario)}{key}"
    print(f"  echowing follow {leader} {ends} {told} --engage")
    _warn_of_refusal(scenario)
    print(f"{STARTS} Ctrl-C ends it.", flush=True)


def _beliefs(scenario: Scenario) -> str:
    """The options of `follow` that say which points the applets take, and what the sonars are."""
    points = "" if scenario.guidance_settings().feed_forward else " --position-only"
    legs = "" if scenario.leader.target == "foil" else f" --legs {scenario.leader.target}"
    return f"{points}{_sonar(scenario)}{legs}"


def _sonar(scenario: Scenario) -> str:
    file = scenario.sonar.file
    return "" if file == SHIPPED_SONAR else f" --sonar {shlex.quote(file)}"


def _chained(scenario: Scenario) -> str:
    """What lets `follow` take slots behind each other."""
    chained = any(slot.behind is not None for slots in scenario.all_slots() for slot in slots)
    return " --simulated" if chained else ""


def _warn_of_refusal(scenario: Scenario) -> None:
    """Say that `follow` does not take this formation, though a scenario does."""
    try:
        separation_m = _stricter_m(scenario.formation)
        for slots in scenario.all_slots():
            check_formation(slots, scenario.sonar_belief, LEAST_M, separation_m)
        shapes = scenario.formation.shapes()
        check_changes([*shapes, *shapes[:1]])
    except EchowingError as error:
        print(f"follow will refuse it: {error}")


def _indices(scenario: Scenario) -> range:
    return range(len(scenario.formation.slots))


def _places(scenario: Scenario, port: int) -> str:
    """The options of `follow` that say where; several slots go into a file."""
    gaps = " --close-gaps" if scenario.formation.close_gaps else ""
    return _slots_option(scenario, port) + gaps


def _slots_option(scenario: Scenario, port: int) -> str:
    formation, slots = scenario.formation, scenario.formation.slots
    if formation.shape is not None and _stricter_m(formation) is None:
        names = ",".join(name for name, _ in formation.shapes())
        return f"--formation {names} --spacing {formation.spacing_m:g}"
    alone = slots[0]
    if len(slots) == 1 and alone.altitude_step_m == 0.0:
        angle = "" if alone.angle_deg == 0.0 else f" --angle {alone.angle_deg:g}"
        return f"--radius {alone.radius_m:g}{angle}"
    path = Path("out") / f"formation-{port}.toml"
    try:
        path.parent.mkdir(exist_ok=True)
        path.write_text(_as_toml(formation), encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"{path}: cannot be written: {error.strerror}") from error
    return f"--formation {path}"


def _stricter_m(formation: FormationSection) -> float | None:
    """How far apart `follow` is to want these slots; None: as far as it does by itself.

    What a scenario allows for a simulated flight must not loosen what the field tool demands.
    """
    told_m = formation.slot_separation_m
    return told_m if told_m is not None and told_m > receivers_demand_m(LEAST_M) else None


def _as_toml(formation: FormationSection) -> str:
    told: dict[str, Any] = dict.fromkeys((*SHAPE_KEYS, "changes"), True)
    if formation.shape is None:
        told = {"slots": {"__all__": PLACE}}
    table = formation.model_dump(include=told, exclude_none=True)
    if not formation.changes:
        table.pop("changes", None)
    stricter_m = _stricter_m(formation)
    separation = {} if stricter_m is None else {"slot_separation_m": stricter_m}
    return tomli_w.dumps(separation | table)
