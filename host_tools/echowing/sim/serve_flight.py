"""A scenario's world in real time for other tools: vehicles in the air, nobody on the ground."""

from contextlib import closing
from pathlib import Path

from echowing.errors import EchowingError
from echowing.sim.flight import FormationWorld
from echowing.sim.ground import TELEMETRY
from echowing.sim.hangar import Hangar
from echowing.sim.parked import ParkedHangar, ParkedWorld, insert_cards
from echowing.sim.scenario import Scenario
from echowing.sim.serve import Endpoint, Server
from echowing.sim.vehicles import LeaderPilot, SimVehicle
from echowing.stopping import stop_on_signals

# Ports of one vehicle, as SITL lays them out: the next vehicle 10 on, a second link 2 on.
VEHICLE_PORTS = 10
PILOT_PORT = 2
PILOT_LINK = "pilot"
HIGHEST_PORT = 65_535


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
) -> int:
    """Fly `scenario` in real time until Ctrl-C or SIGTERM; returns the exit code.

    With `parked` its vehicles stand on the ground instead, as they come from the factory. `cards`
    is a folder for the SD cards of the followers, each in a folder named by its system id.

    The leader's telemetry is on TCP `port` of this machine, each follower's 10 further on, and a
    second link of each vehicle, for the pilot's own ground station, 2 above its first. With a key
    the telemetry is signed; the second link stays unsigned, as a vehicle's USB does.
    Raises EchowingError for a port or a folder that cannot be had.
    """
    if scenario.kind != "formation":
        raise EchowingError(f"--serve: scenario {scenario.name} has no leader and followers")
    if scenario.fault:
        raise EchowingError(f"--serve: the faults of {scenario.name} are flown without it only")
    _check_ports(port, 1 + len(scenario.slots()))
    world = _world(scenario, seed, parked=parked)
    if cards is not None:
        insert_cards(world.followers, cards)
    with closing(Server(lambda t_s: world.step())) as server, stop_on_signals() as stop:
        _connect(server, world, port)
        if signing_key is not None:
            for vehicle in (world.leader, *world.followers):
                vehicle.autopilot.sign_link(TELEMETRY, signing_key)
        server.run(stop)
    print("stopped", flush=True)
    return 0


def _world(scenario: Scenario, seed: int, *, parked: bool) -> FormationWorld:
    if parked:
        return ParkedWorld(scenario, ParkedHangar(scenario, seed))
    return FormationWorld(scenario, Hangar(scenario, seed))


def _check_ports(port: int, vehicles: int) -> None:
    highest = HIGHEST_PORT - VEHICLE_PORTS * (vehicles - 1) - PILOT_PORT
    if not 1 <= port <= highest:
        raise EchowingError(f"--serve {port}: {vehicles} vehicles need a port from 1 to {highest}")


def _connect(server: Server, world: FormationWorld, port: int) -> None:
    vehicles: list[SimVehicle] = [world.leader, *world.followers]
    for index, vehicle in enumerate(vehicles):
        autopilot = vehicle.autopilot
        leads = vehicle is world.leader
        endpoint = SilencedLeader(autopilot, world.pilot) if leads else autopilot
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
