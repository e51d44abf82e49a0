"""A leader and its followers in the air, with all that a user has: what each case begins with."""

import contextlib
import itertools
import math
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from echowing.analysis.metrics import Metrics
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import flown_up
from echowing.flight.guidance import Slot, place_m
from echowing.geo import GlobalPosition, Ned, displace
from echowing.sim.world.gps import VELOCITY_TAU_S

from . import truth
from .drift import Drift
from .names import (
    DRIFT_EAST,
    DRIFT_NORTH,
    DRIFT_UP,
    OFF_EAST,
    OFF_NORTH,
    WIND,
    WIND_SPEED,
    Version,
)
from .relay import LOOPBACK, Link
from .serial_sonar import WIRING, SerialSonar
from .sonar import Feeder, Scene, silence, vehicles
from .tools import Tool, port_told, run
from .vehicle import BOOT_S, ORIGIN, TO_COPROCESSOR, Vehicle

LEADER, FOLLOWER = 1, 2
HEIGHT_M = 10.0
# The demo's flight (echowing/sim/scenario.py): its receivers, radios and radius.
SIGMA_M, TAU_S = 0.8, 60.0
VELOCITY_SIGMA_MPS = 0.05
LEADER_LATENCY_S, FOLLOWER_LATENCY_S = 0.46, 0.05
RADIUS_M = 3.0
DRIFT_PERIOD_S = 0.5
# The autopilot needs about a minute to know where it is.
BOOT_SPEEDUP = 8.0
# Two receivers' clocks are the same when what they say at 2 m/s is the same within 4 cm.
CLOCKS_S = 0.02
# As the emulator says that it does not keep up, and how late a datagram may be for its sonar.
SLOW_EMULATOR = "too slow for real time"
FED_LATE_S = 0.15
# Below, the autopilots' time-outs and the ages of what they say are not those of a real flight.
REAL_TIME = 0.98
NEAR_SLOT_M = 1.5  # two receivers disagree by so much, and sonar comes into it only later
SERIAL = "2"  # the co-processor's
APART_M = 6.0  # on the ground
WAITS_S = 5.0  # in its slot, before the leader starts


@dataclass(frozen=True, slots=True)
class Kit:
    """What all cases of one binary share. prepared: a follower's folder after README's commands."""

    binary: Path
    version: Version
    prepared: Path


def copied(prepared: Path, folder: Path) -> Path:
    """A follower's folder of its own, without the logs of the first."""
    shutil.copytree(prepared, folder, ignore=shutil.ignore_patterns("logs", "console.txt"))
    return folder


def emulator_of(follower: Vehicle, *more: str, board: str = "mega") -> Tool:
    """The co-processor's binary, or its core (native), plugged into the follower's SERIAL2."""
    link = f"tcp:{LOOPBACK}:{follower.coprocessor}"
    return Tool("emulator", "--board", board, "--link", link, "--target", "udp:0", *more)


@dataclass(frozen=True, slots=True)
class Preparation:
    """What README's two commands and the check after them have said."""

    folder: Path
    said: tuple[str, str]
    check: str


def prepare(binary: Path, folder: Path) -> Preparation:
    """Make a follower ready, on the ground, by README's two commands."""
    with contextlib.ExitStack() as stack:
        follower = Vehicle(binary, FOLLOWER, folder)
        stack.callback(follower.close)
        emulator = emulator_of(follower)
        stack.callback(emulator.kill)
        Feeder(follower, port_told(emulator), silence)
        follower.until_heard()
        wiring = ("--serial", SERIAL)
        said = two_commands(follower, *wiring)
        follower.until_heard()
        follower.until_positioned()
        check = run("setup", "check", "--vehicle", follower.link(), *wiring, code=None)
        return Preparation(folder, said, check)


def two_commands(follower: Vehicle, *wiring: str) -> tuple[str, str]:
    """README's two commands, and what they say."""
    vehicle = ("--vehicle", follower.link())
    kept = ("--save", str(follower.folder / "old.params.json"))
    return (
        run("setup", "lua", *vehicle, "--folder", "scripts"),
        run("setup", "apply", *vehicle, *wiring, "--yes", "--restart", *kept),
    )


class Follower:
    """A follower with its co-processor.

    sonar: what it truly hears, keys of a scenario's [sonar]; none: all within 20 degrees. board:
    that `echowing emulator` runs.
    """

    def __init__(
        self, vehicle: Vehicle, scene: Scene, sonar: Sequence[str] = (), board: str = "mega"
    ) -> None:
        self.vehicle, self._board = vehicle, board
        self._sonar = [word for change in sonar for word in ("--sonar", change)]
        self.emulator = emulator_of(vehicle, *self._sonar, board=board)
        self.feeder = Feeder(vehicle, port_told(self.emulator), scene)

    def unplug(self) -> None:
        """Take the co-processor's plug out."""
        self.feeder.close()
        self.emulator.kill()

    def plug_in(self) -> None:
        """Put it back; the board starts anew."""
        scene = self.feeder.scene
        self.emulator = emulator_of(self.vehicle, *self._sonar, board=self._board)
        self.feeder = Feeder(self.vehicle, port_told(self.emulator), scene)

    def close(self) -> None:
        """End all of it."""
        self.unplug()
        self.vehicle.close()

    @property
    def too_slow(self) -> bool:
        """Whether its co-processor did not keep up."""
        return any(SLOW_EMULATOR in line for line in self.emulator.lines)


class SelfReading:
    """A follower whose autopilot reads its sonar itself: no co-processor, no gimbal."""

    too_slow = False

    def __init__(self, vehicle: Vehicle, sonar: SerialSonar) -> None:
        self.vehicle, self.feeder = vehicle, sonar
        self.plug_in()

    def unplug(self) -> None:
        """Take the sonar's plug out."""
        self.feeder.close()

    def plug_in(self) -> None:
        """Put it in, or back."""
        self.feeder.ride(self.vehicle)


class Formation:
    """A leader and its followers, started, their receivers drifting.

    seed: of the receivers' offsets, those of the built-in simulator. slots: of a formation, which
    is parked as large as its pilots fly it up; none: `followers` of them, side by side. latency_s,
    follower_latency_s: of the leader's link and the followers', each way. wind_mps: from the
    north, the same at all heights, without gusts. drifting: whether the receivers have
    offsets. wandering: whether these change from the start, or only from `let_wander` on. sonar:
    see `Follower`. reads_itself: followers have no co-processor, but a sonar that their autopilots
    read. sigma_m, height_sigma_m: by how much each receiver wanders per axis, and each
    barometer, standard deviations.
    same_clock: the receivers tell the same time of day, which counts where logs are laid side by
    side. key: all sign with it, by the time of day, so they start at its pace.
    """

    def __init__(
        self,
        kit: Kit,
        folder: Path,
        seed: int = 1,
        *,
        followers: int = 1,
        slots: Sequence[Slot] = (),
        latency_s: float = LEADER_LATENCY_S,
        follower_latency_s: float = FOLLOWER_LATENCY_S,
        wind_mps: float = 0.0,
        drifting: bool = True,
        wandering: bool = True,
        sonar: Sequence[str] = (),
        reads_itself: bool = False,
        sigma_m: float = SIGMA_M,
        height_sigma_m: float = 0.0,
        same_clock: bool = False,
        key: bytes | None = None,
    ) -> None:
        self.kit, self.folder, self._key = kit, folder, key
        self._seed, self._wandering = seed, wandering
        self.drifts: dict[int, Drift] = {}
        """Of each vehicle's receiver, by system id."""
        self._ahead = [slot.behind for slot in slots] or [None] * followers
        parked = [place_m(flown_up(slots, LEAST_M), n) for n in range(len(slots))]
        self._sonar, self._sigma_m, self._height_sigma_m = sonar, sigma_m, height_sigma_m
        self._reads_itself = reads_itself
        self._stack = contextlib.ExitStack()
        self._tools: list[Tool] = []
        self.armed_s = math.nan
        self.followers: list[Follower | SelfReading] = []
        with self._guarded():
            self.leader = self._vehicle(LEADER, folder / "leader", (0.0, 0.0, 0.0), fresh=True)
            for place in enumerate(parked or _parked(followers)):
                self.followers.append(self._follower(*place))
            for follower in self.followers:
                follower.feeder.scene = self.scene(follower.vehicle)
            self.leader_link = self._link(self.leader, latency_s)
            self.follower_links = [self._link(v, follower_latency_s) for v in self._of_followers()]
            self._wake(drifting=drifting)
            if wind_mps:
                self._blow(wind_mps)
            if same_clock:
                self._set_clocks()

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._stack.close()
            raise

    def _vehicle(
        self,
        system_id: int,
        folder: Path,
        at_ned_m: Ned,
        *,
        fresh: bool,
        sonar: SerialSonar | None = None,
    ) -> Vehicle:
        vehicle = Vehicle(
            self.kit.binary,
            system_id,
            folder,
            fresh=fresh,
            at_ned_m=at_ned_m,
            speedup=BOOT_SPEEDUP if self._key is None else 1.0,
            factory=None if sonar is None else WIRING,
            serial2=TO_COPROCESSOR if sonar is None else sonar.line,
        )
        self._stack.callback(vehicle.close)
        return vehicle

    def let_wander(self) -> None:
        """From now on the receivers' offsets change."""
        self._wandering = True

    def _let_drift(self, vehicle: Vehicle, name: str) -> None:
        drift = self.drifts[vehicle.system_id] = Drift.of_receiver(
            self._sigma_m, TAU_S, self._seed, name
        )
        velocity = Drift.of_receiver(
            VELOCITY_SIGMA_MPS, VELOCITY_TAU_S, self._seed, f"{name} velocity"
        )
        height = Drift.of_receiver(self._height_sigma_m, TAU_S, self._seed, f"{name} height")
        starts_at_m = height.north_m  # a barometer is set to zero where it stands
        north, east = vehicle.name_of(DRIFT_NORTH), vehicle.name_of(DRIFT_EAST)
        off_north, off_east = vehicle.name_of(OFF_NORTH), vehicle.name_of(OFF_EAST)

        def wander() -> None:
            if self._wandering:
                drift.step(DRIFT_PERIOD_S)
                velocity.step(DRIFT_PERIOD_S)
                height.step(DRIFT_PERIOD_S)
                vehicle.put(off_north, velocity.north_m)
                vehicle.put(off_east, velocity.east_m)
                vehicle.put(DRIFT_UP, height.north_m - starts_at_m)
            north_deg, east_deg = drift.degrees(ORIGIN.lat_deg)
            vehicle.put(north, north_deg)
            vehicle.put(east, east_deg)

        vehicle.every("drift", DRIFT_PERIOD_S, wander)

    def _follower(self, number: int, at_ned_m: Ned) -> Follower | SelfReading:
        system_id = FOLLOWER + number
        folder = copied(self.kit.prepared, self.folder / f"follower-{system_id}")
        if self._reads_itself:
            sonar = SerialSonar()
            vehicle = self._vehicle(system_id, folder, at_ned_m, fresh=False, sonar=sonar)
            self._stack.callback(sonar.end)
            follower: Follower | SelfReading = SelfReading(vehicle, sonar)
        else:
            vehicle = self._vehicle(system_id, folder, at_ned_m, fresh=False)
            # Two cores carry two autopilots and one board's binary in real time, and not more.
            board = "mega" if len(self._ahead) == 1 else "native"
            follower = Follower(vehicle, silence, self._sonar, board)
        self._stack.callback(follower.unplug)
        return follower

    def scene(self, own: Vehicle) -> Scene:
        """The others, as a follower's sonar finds them."""
        everybody = [self.leader, *self._of_followers()]
        return vehicles([vehicle for vehicle in everybody if vehicle is not own])

    def _of_followers(self) -> list[Vehicle]:
        return [follower.vehicle for follower in self.followers]

    def _link(self, vehicle: Vehicle, latency_s: float) -> Link:
        link = Link(vehicle.usb, latency_s)
        self._stack.callback(link.close)
        return link

    @property
    def follower(self) -> Vehicle:
        """The first follower's autopilot."""
        return self.followers[0].vehicle

    @property
    def everybody(self) -> list[Vehicle]:
        """Leader and followers."""
        return [self.leader, *self._of_followers()]

    def _wake(self, *, drifting: bool) -> None:
        """Let them find their positions fast, then let time pass as it does."""
        for vehicle in self.everybody:
            vehicle.until_heard()
            if self._key is not None:
                vehicle.sign(self._key)
        if drifting:
            self._let_drift(self.leader, "leader")
            for number, vehicle in enumerate(self._of_followers()):
                self._let_drift(vehicle, f"follower {number}")
        for vehicle in self.everybody:
            vehicle.until_positioned()
        for vehicle in self.everybody:
            vehicle.speed_up(1.0)

    def _blow(self, wind_mps: float) -> None:
        for vehicle in self.everybody:
            for name, value in {**WIND, WIND_SPEED: wind_mps}.items():
                vehicle.set(name, value)

    def _set_clocks(self) -> None:
        """Let the time of those behind pass faster until all receivers tell the same UTC."""
        until_s = time.monotonic() + BOOT_S
        while True:
            time.sleep(1.2)  # five answers at real time
            ahead_s = [vehicle.utc_ahead_s() for vehicle in self.everybody]
            if max(ahead_s) - min(ahead_s) < CLOCKS_S:
                return
            if time.monotonic() > until_s:
                pytest.fail(f"the vehicles' clocks stay apart: {ahead_s}")
            for vehicle, one_s in zip(self.everybody, ahead_s, strict=True):
                _catch_up(vehicle, max(ahead_s) - one_s)

    def take_off(self) -> None:
        """Everybody armed in Guided and up; the leader first. The last has its log from then on."""
        for vehicle in self.everybody:
            vehicle.arm()
            self.armed_s = time.monotonic()
            vehicle.take_off(HEIGHT_M)

    def follow(self, *more: str, radius_m: float | None = RADIUS_M, engage: bool = True) -> Tool:
        """`echowing follow` on links as late as radios are."""
        seats = ["--leader", f"{self.leader_link.where}@{LEADER}"]
        for link, vehicle in zip(self.follower_links, self._of_followers(), strict=True):
            seats += ["--follower", f"{link.where}@{vehicle.system_id}"]
        radius = [] if radius_m is None else ["--radius", f"{radius_m:g}"]
        engaged = ["--engage"] if engage else []
        log = ["--log", str(self.folder / "log")]
        tool = Tool("follow", *seats, *radius, *engaged, *log, "--json", *more)
        self._stack.callback(tool.kill)
        self._tools.append(tool)
        return tool

    def fly_in_formation(self, *more: str) -> Tool:
        """Take off, start `follow`, and wait until the follower stands in its slot."""
        self.take_off()
        tool = self.follow(*more)
        tool.wait_for(lambda line: '"following"' in line)
        self.until_in_slot()
        return tool

    def until_in_slot(self, wanted_m: float = RADIUS_M, within_s: float = 60.0) -> None:
        """Wait until all followers have been near their distance for three seconds."""
        since_s = time.monotonic()
        until_s = since_s + within_s
        while time.monotonic() - since_s < 3.0:
            time.sleep(0.1)
            apart_m = [self._separation_m(*pair) for pair in self.watched()]
            if max(abs(one_m - wanted_m) for one_m in apart_m) > NEAR_SLOT_M:
                since_s = time.monotonic()
            if time.monotonic() > until_s:
                pytest.fail(f"never in their slots: {apart_m} m from whom they watch")

    def watched(self) -> list[tuple[Vehicle, Vehicle]]:
        """Each follower, and before it whom its sonar watches."""
        followers = self._of_followers()
        return [
            (self.leader if ahead is None else followers[ahead], vehicle)
            for ahead, vehicle in zip(self._ahead, followers, strict=True)
        ]

    def _separation_m(self, watched: Vehicle, follower: Vehicle) -> float:
        """In truth, now."""
        states = [watched.state, follower.state]
        return float(np.linalg.norm(np.subtract(*truth.track_ned_m(states))))

    def fly_mission(self, tool: Tool, speed_mps: float, for_s: float) -> float:
        """Let the receivers wander, and the leader fly its mission; when it began."""
        self.let_wander()
        rest(WAITS_S)
        began_s = time.monotonic()
        self.leader.fly_mission(speed_mps)
        while time.monotonic() < began_s + for_s:
            assert tool.running, tool.lines[-10:]
            time.sleep(1.0)
        return began_s

    def place(self, north_m: float, east_m: float) -> GlobalPosition:
        """A point about the origin."""
        return displace(ORIGIN, (north_m, east_m, 0.0))

    def measured(self, from_s: float, to_s: float, wanted_m: float = RADIUS_M) -> Metrics:
        """Separation of leader and first follower over a part of the flight."""
        return truth.figures(
            self.leader.heard.truth, self.follower.heard.truth, from_s, to_s, wanted_m
        )

    def least_m(self, from_s: float, to_s: float) -> float:
        """The least distance of any two vehicles over a part of the flight."""
        pairs = itertools.combinations(self.everybody, 2)
        return min(
            truth.figures(a.heard.truth, b.heard.truth, from_s, to_s, RADIUS_M).min_separation_m
            for a, b in pairs
        )

    def note(self, since_s: float) -> str:
        """What has to stand beside a figure: a machine that did not keep up since then."""
        pace = min(vehicle.pace(since_s) for vehicle in self.everybody)
        gap_s = max(truth.longest_gap_s(v.heard.truth, since_s) for v in self.everybody)
        late = any(follower.too_slow for follower in self.followers)
        notes = [
            f"slow: {pace:.2f} of real time" if pace < REAL_TIME else "",
            f"sonar fed {gap_s:.1f} s late" if gap_s > FED_LATE_S else "",
            "emulator too slow" if late else "",
        ]
        return "; ".join(filter(None, notes))

    def close(self) -> None:
        """End all that was started, and write down what it has said and where it truly was."""
        for vehicle in self.everybody:
            truth.write(self.folder / f"truth-{vehicle.system_id}.csv", vehicle.heard.truth)
        self._stack.close()
        for tool in self._tools:
            lines = [f"{line}\n" for line in tool.lines]
            (self.folder / f"{tool.name}.txt").write_text("".join(lines))


def _parked(followers: int) -> list[Ned]:
    """Where they start: behind the leader, several of them side by side, the first to the east."""
    return [
        (-APART_M, APART_M * ((followers - 1) / 2 - number), 0.0) for number in range(followers)
    ]


def _catch_up(vehicle: Vehicle, behind_s: float) -> None:
    """Let its time pass faster until it has gained so much."""
    if behind_s < CLOCKS_S / 2:
        return
    factor = 1.0 + min(3.0, max(0.1, behind_s))
    vehicle.speed_up(factor)
    started_s = vehicle.heard.clock[-1]
    gained_s = 0.0
    while gained_s < behind_s * 0.95:
        time.sleep(0.01)
        newest_s = vehicle.heard.clock[-1]
        # What passes until the answer to the last word is not known: the loop around sees to it.
        elapsed_s = time.monotonic() - newest_s[0]
        gained_s = newest_s[1] - started_s[1] - (newest_s[0] - started_s[0])
        gained_s += elapsed_s * (factor - 1.0)
    vehicle.speed_up(1.0)


def still(vehicle: Vehicle, within_s: float) -> float:
    """Seconds from now until the vehicle stands for good: slower than 0.3 m/s for a second."""
    began_s = moved_s = time.monotonic()
    while time.monotonic() - moved_s < 1.0:
        time.sleep(0.02)
        if vehicle.speed_mps > 0.3:
            moved_s = time.monotonic()
        if time.monotonic() - began_s > within_s:
            return math.inf
    return moved_s - began_s


def rectangle(formation: Formation, laps: int = 3) -> Sequence[GlobalPosition]:
    """The demo's way: 60 m north, 40 m east, and back."""
    lap = ((60.0, 0.0), (60.0, 40.0), (0.0, 40.0), (0.0, 0.0))
    return [formation.place(*corner) for _ in range(laps) for corner in lap]


def rest(duration_s: float) -> None:
    """Let them fly."""
    time.sleep(max(0.0, duration_s))
