"""Fuzz the applets:  python -m tests.lua.fuzz [--seconds S | --cases N] [--seed K]

Flies each applet of lua/ through drawn flights: frames changed, cut and joined, impossible
readings, parameters out of range, an estimator without a value or with NaN, scripts that die. A
find is made as small as it can be and printed with the command that flies it again.
"""

from __future__ import annotations

import argparse
import math
import re
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from pathlib import Path
from random import Random
from typing import Any

from tests.lua.hostile_frames import (
    BOARD,
    HERE,
    TOOL,
    is_whole,
    mutated,
    odd,
    packed,
    point,
    reading,
    spliced,
    spoiled,
    through_radio,
    whole,
)

from echowing.mavlink.messages import WITHOUT_HEIGHT, Manner
from echowing.paths import lua_folder
from echowing.sim.vehicle.desk import GOOD, DeskVehicle
from echowing.sim.vehicle.luahost import LuaHost
from echowing.sim.vehicle.parameters import Generation

GUIDED, LOITER = 4, 5
SET_ATTITUDE, VEHICLE = 284, 1
STEP_MS = 10
POINT_MS, READING_MS = 120, 100
# What no target of an applet is beyond: the leader is within the sonar's reach and its point within
# a second's flight of it; no copter is faster, brakes harder or turns its nose quicker.
NEAR_M, FASTEST_MPS, HARDEST_MPS2, TURN_RPS = 50.01, 30.01, 10.01, 4.01  # with 32-bit slack
FLOOR_MPS, MOST_MPS = 0.2, 15.0  # of the speed parameter, ECHO_SPD_MIN and ECHO_SPD_MAX
SLACK = 1e-4  # 32-bit numbers
PILOT_MPS = 10.0
NOBODYS_MPS = 0.0625  # so a pilot's value is never what the applet has written: it could not tell
HANDED_BACK_MS = 500  # two of the applet's pauses out of control
ALIVE_AGAIN_MS = 5000  # all parameters are read within 2 s; then a target is trusted after 0.5 s
NOT_FINITE = re.compile(r"(?<![a-z])-?(nan|inf)(?![a-z])", re.IGNORECASE)
READ_ONLY = {"ECHO_MIRROR", "ECHO_FORMAT"}
MOST_FINDS = 6  # of different kinds, then it ends

Action = tuple[Any, ...]


class BrokenError(Exception):
    """A property that does not hold."""


@dataclass(frozen=True)
class Case:
    """One flight: drawn from applet and number alone. deaf: all its frames are to be dropped."""

    applet: Path
    number: int
    generation: Generation
    starts_ms: int
    moving: bool
    deaf: bool
    actions: tuple[Action, ...]


# ---- drawing -------------------------------------------------------------------------------------


def applets() -> list[Path]:
    return sorted(lua_folder().glob("echowing*.lua"))


@cache
def parameters_of(applet: Path) -> tuple[str, ...]:
    """The names that its documentation blocks give."""
    found = re.findall(r"// @Param: (ECHO_\w+)", applet.read_text(encoding="utf-8"))
    return tuple(name for name in found if name not in READ_ONLY)


def draw(applet: Path, number: int) -> Case:
    rng = Random(f"{applet.stem} {number}")
    deaf = rng.random() < 0.2
    starts_ms = rng.choice([0, 0, rng.randrange(1 << 31), (1 << 31) - 2000, (1 << 32) - 2000])
    drawn = _deaf_actions if deaf else _actions
    return Case(
        applet,
        number,
        rng.choice([Generation.V4_6, Generation.V4_8]),
        starts_ms // STEP_MS * STEP_MS,
        rng.random() < 0.8,
        deaf,
        tuple(drawn(rng, applet, starts_ms)),
    )


def _deaf_actions(rng: Random, _applet: Path, t_ms: int) -> Iterator[Action]:
    """Wrong checksums only, up to four of them between two updates."""
    yield "wait", 150
    for _ in range(rng.randrange(5, 40)):
        for _ in range(rng.randrange(1, 5)):
            yield "frame", spoiled(rng, whole(rng, t_ms + 1500))
        yield "wait", rng.randrange(5, 15)


def _actions(rng: Random, applet: Path, t_ms: int) -> Iterator[Action]:
    yield "wait", rng.choice([0, 50, 150, 150])
    dies = rng.random() < 0.2
    menu: Sequence[Callable[[], Iterator[Action]]] = [
        *[lambda: _frames(rng, t_ms)] * 6,
        *[lambda: _radio(rng, t_ms)] * 2,
        *[lambda: _estimator(rng)] * 4,
        *[lambda: _sonar(rng)] * 3,
        *[lambda: _parameter(rng, applet)] * 3,
        *[lambda: _pilot(rng, dies=dies)] * 3,
        lambda: _traffic(rng),
        lambda: _traffic(rng),
        lambda: _script(rng, dies=dies),
    ]
    for _ in range(rng.randrange(4, 25)):
        yield from rng.choice(menu)()
        if rng.random() < 0.7:
            yield "wait", rng.choice([1, 2, 5, 10, 30, 60])


def _frame(rng: Random, t_ms: int) -> bytes:
    frame = whole(rng, t_ms + rng.randrange(5000))
    how = rng.random()
    if how < 0.4:
        return frame
    if how < 0.6:
        return mutated(rng, frame)
    if how < 0.8:
        return spliced(rng, frame, whole(rng, t_ms))
    return spoiled(rng, frame)


def _frames(rng: Random, t_ms: int) -> Iterator[Action]:
    for _ in range(rng.choice([1, 1, 1, 3, 12])):
        yield "frame", _frame(rng, t_ms)
        if rng.random() < 0.5:
            yield "wait", rng.randrange(1, 10)


def _radio(rng: Random, t_ms: int) -> Iterator[Action]:
    stream = b"".join(whole(rng, t_ms) for _ in range(rng.randrange(4, 20)))
    for frame in through_radio(rng, stream, rng.choice([0.05, 0.2])):
        yield "frame", frame
        yield "wait", rng.randrange(1, 12)


def _vector(rng: Random, most: float) -> tuple[float, float, float] | None:
    if rng.random() < 0.2:
        return None
    return odd(rng, -most, most), odd(rng, -most, most), odd(rng, -2.0, 2.0)


def _estimator(rng: Random) -> Iterator[Action]:
    far_m = rng.choice([1.0, 2000.0])
    yield rng.choice(
        [
            ("vehicle", "velocity", _vector(rng, 4.0)),
            ("vehicle", "velocity", (rng.uniform(-3.0, 3.0), rng.uniform(-1.0, 1.0), 0.0)),
            ("vehicle", "position", _vector(rng, far_m)),
            ("vehicle", "position", (0.0, 0.0, -10.0)),
            ("vehicle", "yaw", odd(rng, -math.pi, math.pi)),
            ("vehicle", "height_m", odd(rng, -2.0, 100.0)),
            ("vehicle", "place", rng.choice([None, HERE, (0.0, 0.0, 0.0), (-39.0, 179.9, 10.0)])),
            ("vehicle", "is_flying", rng.random() < 0.7),
            ("vehicle", "takes_posvel", rng.random() < 0.7),
            (
                "vehicle",
                "target",
                rng.choice([None, (*HERE, "absolute"), (0.0, 0.0, 0.0, "above_home")]),
            ),
        ]
    )


def _sonar(rng: Random) -> Iterator[Action]:
    yield "range", rng.choice([0, 1, 2, 3, GOOD, GOOD, GOOD]), odd(rng, 0.1, 8.0, 0.4)


def _parameter(rng: Random, applet: Path) -> Iterator[Action]:
    yield "applet", rng.choice(parameters_of(applet)), odd(rng, -1.0, 20.0, 0.4)


def _pilot(rng: Random, *, dies: bool) -> Iterator[Action]:
    """A value of the pilot's that a dying script has not mirrored yet is lost: not both in one."""
    yield rng.choice(
        [
            ("vehicle", "mode", rng.choice([GUIDED, GUIDED, 0, 3, LOITER, 6])),
            ("vehicle", "is_armed", rng.random() < 0.7),
            ("switch", rng.choice([300, 301]), rng.choice([None, 0, 1, 2, 2])),
            ("wait", 5) if dies else ("pilot", rng.randrange(4, 58) / 4.0 + NOBODYS_MPS),
        ]
    )


def _traffic(rng: Random) -> Iterator[Action]:
    """What is whole and true changes as well."""
    yield rng.choice(
        [
            ("traffic", "points", rng.random() < 0.7),
            ("traffic", "readings", rng.random() < 0.7),
            ("traffic", "leader_m", rng.uniform(0.4, 5.0)),
            ("traffic", "ahead_m", rng.uniform(-6.0, 6.0)),
            ("traffic", "velocity_mps", (rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0))),
            ("traffic", "opens_m", rng.choice([0.0, 3.5, 6.0])),
            ("traffic", "manner", float(rng.randrange(len(Manner)))),
            ("traffic", "yaw_rad", rng.choice([None, rng.uniform(-math.pi, math.pi)])),
        ]
    )


def _script(rng: Random, *, dies: bool) -> Iterator[Action]:
    if dies:
        yield "kill", rng.randrange(1, 2000)
        yield "wait", rng.randrange(1, 60)
        yield ("restart",)
    yield rng.choice(
        [("restart",), ("pause", rng.randrange(50, 5000)), ("pause", rng.randrange(50, 500))]
    )


# ---- flying --------------------------------------------------------------------------------------


class Traffic:
    """The true messages of a formation: a ground tool's points, a co-processor's readings."""

    def __init__(self, *, moving: bool) -> None:
        self.points = self.readings = True
        self.moving = moving
        self.leader_m, self.ahead_m, self.opens_m, self.manner = 3.0, 0.0, 0.0, 0.0
        self.velocity_mps = (1.0, 0.0)
        self.yaw_rad: float | None = 0.0

    def frames(self, t_ms: int) -> Iterator[bytes]:
        if self.points and t_ms % POINT_MS == 0:
            told = point(
                t_ms,
                self.ahead_m,
                0.0,
                self.velocity_mps if self.moving else None,
                yaw_rad=self.yaw_rad,
                opens_m=self.opens_m,
                manner=self.manner,
            )
            yield packed(told, TOOL)
        if self.readings and t_ms % READING_MS == 0:
            wavers_m = 0.01 * (t_ms // READING_MS % 3)  # else the sonar is stuck
            yield packed(reading(t_ms, self.leader_m + wavers_m), BOARD)


class Flight:
    """A case on its way. Raises BrokenError at once where a property does not hold."""

    def __init__(self, case: Case) -> None:
        self.case = case
        old = case.generation is Generation.V4_6
        self.speed_name = "WPNAV_SPEED" if old else "WP_SPD"
        self.units = 100.0 if old else 1.0
        self.pilot_mps = PILOT_MPS
        firmware = {
            self.speed_name: PILOT_MPS * self.units,
            "SYSID_THISMAV" if old else "MAV_SYSID": 1.0,
            "RNGFND1_TYPE": 10.0,
            "RNGFND1_ORIENT": 0.0,
        }
        self.vehicle = DeskVehicle({**firmware, "ECHO_ENABLE": 1.0}, t_ms=case.starts_ms)
        self.traffic = Traffic(moving=case.moving)
        self._sane()
        self.host = self._new_host()
        self.killed = False
        self.not_ours_ms = 0
        self.commands: list[Any] = []
        """All that the applet has commanded, in a deaf flight."""

    def _new_host(self) -> LuaHost:
        self.killed = False
        return LuaHost(self.vehicle, self.case.applet, generation=self.case.generation)

    def _sane(self) -> None:
        vehicle = self.vehicle
        vehicle.position, vehicle.place, vehicle.height_m = (0.0, 0.0, -10.0), HERE, 10.0
        vehicle.velocity, vehicle.yaw = (1.0, 0.0, 0.0), 0.0
        vehicle.is_armed = vehicle.is_flying = vehicle.takes_posvel = True
        vehicle.ranges[0], vehicle.target, vehicle.mode = (GOOD, 3.0), None, GUIDED

    def fly(self, *, deafened: bool = False) -> None:
        """All of it; deafened: without the frames that hostile radios add."""
        self._start()
        for action in self.case.actions:
            if not (deafened and action[0] == "frame"):
                self._do(action)
        self._land()
        self._come_back()

    def _do(self, action: Action) -> None:
        vehicle = self.vehicle
        match action:
            case ("wait", steps):
                self._wait(steps)
            case ("frame", frame):
                vehicle.inbox.append((frame, 0))
            case ("vehicle", name, value):
                setattr(vehicle, name, value)
            case ("range", status, range_m):
                vehicle.ranges[0] = (status, range_m)
            case ("applet", name, value):
                vehicle.parameters[name] = value
            case ("pilot", mps):
                self.pilot_mps = mps
                vehicle.parameters[self.speed_name] = mps * self.units
            case ("switch", option, None):
                vehicle.switches.pop(option, None)
            case ("switch", option, position):
                vehicle.switches[option] = position
            case ("traffic", name, value):
                setattr(self.traffic, name, value)
            case ("kill", instructions):
                self.host.kill_after(instructions)
                self.killed = True
            case ("restart",):
                # What a pilot sets while no script looks at it is taken for the dead script's.
                self._wait(6)
                self.host = self._new_host()
                self._start()
            case ("pause", milliseconds):
                vehicle.t_ms += milliseconds // STEP_MS * STEP_MS

    def _start(self) -> None:
        """Nothing comes between: its parameters are added anew, the mirror among them."""
        self._wait(2)  # the first run may only give the function that starts it

    def _wait(self, steps: int) -> None:
        for _ in range(steps):
            self.vehicle.t_ms += STEP_MS
            for frame in self.traffic.frames(self.vehicle.t_ms):
                self.vehicle.inbox.append((frame, 0))
            self.host.step(self.vehicle.t_ms)
            self._check()

    def _land(self) -> None:
        """The pilot takes over: his speed is back."""
        if self.killed:
            self.host = self._new_host()
        self.vehicle.mode = LOITER
        self._wait(HANDED_BACK_MS // STEP_MS + 10)

    def _come_back(self) -> None:
        """Once all is well, it does its work again."""
        self.vehicle.saved = {"ECHO_ENABLE": 1.0}  # the others as they come
        self._sane()
        self.traffic = Traffic(moving=self.case.moving)
        self.host = self._new_host()
        self._wait(ALIVE_AGAIN_MS // STEP_MS)
        if self._mirror() == 0.0:
            raise BrokenError("not in control again")

    # ---- properties

    def _mirror(self) -> float:
        return self.vehicle.parameters.get("ECHO_MIRROR", 0.0)

    def _check(self) -> None:
        vehicle = self.vehicle
        if self.host.error is not None and not self.killed:
            raise BrokenError(f"script error: {self.host.error}")
        for _, text in vehicle.texts:
            self._check_text(text)
        for kind, target in vehicle.targets:
            self._check_target(kind, target)
        for speed_mps in vehicle.desired_speeds:
            if not FLOOR_MPS - SLACK <= speed_mps <= MOST_MPS + SLACK:
                raise BrokenError(f"speed limit {speed_mps}")
        for _, message_id, payload in vehicle.sent:
            self._check_look(message_id, payload)
        self._check_told()
        self._check_speed()
        if self.case.deaf:
            commanded = *vehicle.targets, *vehicle.desired_speeds, *vehicle.sent
            self.commands += [*commanded, self._mirror()]
        for record in (vehicle.texts, vehicle.targets, vehicle.sent, vehicle.log):
            record.clear()
        vehicle.desired_speeds.clear()
        vehicle.named.clear()

    def _check_text(self, text: str) -> None:
        if self.killed and text.startswith("Lua:"):
            return
        if text.startswith(("ECHO: error", "Lua:")):
            raise BrokenError(f"script error: {text}")
        if NOT_FINITE.search(text):
            raise BrokenError(f"not finite in a text: {text}")

    def _check_target(self, kind: str, target: Sequence[Any]) -> None:
        numbers = [value for value in target if isinstance(value, float)]
        if not all(map(math.isfinite, numbers)):
            raise BrokenError(f"target not finite: {kind} {target}")
        if kind not in ("position", "posvel"):
            raise BrokenError(f"a target of another kind: {kind}")
        here = self.vehicle.position
        if here is None or math.dist(here, target[:3]) > NEAR_M:
            raise BrokenError(f"far target: {kind} {target[:3]} from {here}")
        if kind == "position":
            return
        velocity, acceleration = target[3:6], target[7:10]
        if math.hypot(*velocity) > FASTEST_MPS:
            raise BrokenError(f"fast target: {velocity}")
        if math.hypot(*acceleration) > HARDEST_MPS2 or abs(target[10]) > TURN_RPS:
            raise BrokenError(f"hard target: {acceleration}, {target[10]} rad/s")

    def _check_look(self, message_id: int, payload: bytes) -> None:
        """Only orders to the own gimbal leave, that look somewhere, no faster than it could."""
        if message_id != SET_ATTITUDE:
            raise BrokenError(f"sends message {message_id}")
        *numbers, flags, system, component = struct.unpack("<7fHBB", payload)
        quaternion, (unsure_rad, up_rps, turn_rps) = numbers[:4], numbers[4:]
        told = f"{numbers}, flags {flags}, to {system}/{component}"
        if not all(map(math.isfinite, numbers)):
            raise BrokenError(f"look not finite: {told}")
        if abs(math.hypot(*quaternion) - 1.0) > SLACK or quaternion[1:3] != [0.0, 0.0]:
            raise BrokenError(f"a look that is no direction: {told}")
        if not 0.0 <= unsure_rad <= math.pi / 2.0 + SLACK or max(up_rps, abs(turn_rps)) > TURN_RPS:
            raise BrokenError(f"a look beyond what a gimbal can: {told}")
        if (flags, system) != (WITHOUT_HEIGHT, VEHICLE):
            raise BrokenError(f"an order that is not the gimbal's: {told}")

    def _check_told(self) -> None:
        told = [value for values in self.vehicle.named.values() for value in values]
        told += [v for _, values in self.vehicle.log for v in values if isinstance(v, float)]
        if not all(map(math.isfinite, told)):
            raise BrokenError(f"not finite told: {self.vehicle.named}, {self.vehicle.log}")

    def _check_speed(self) -> None:
        mps = self.vehicle.parameters[self.speed_name] / self.units
        if not FLOOR_MPS - SLACK <= mps <= MOST_MPS + SLACK:
            raise BrokenError(f"speed parameter {mps} m/s")
        ours = self.vehicle.is_armed and self.vehicle.mode == GUIDED
        self.not_ours_ms = 0 if ours or self.killed else self.not_ours_ms + STEP_MS
        given_back = self._mirror() == 0.0
        if self.not_ours_ms > HANDED_BACK_MS and not given_back:
            raise BrokenError("not handed back")
        if given_back and abs(mps - self.pilot_mps) > SLACK:
            raise BrokenError(f"handed back at {mps} m/s, the pilot's is {self.pilot_mps} m/s")


def broken(case: Case) -> str | None:
    """The property that a case breaks, None if all hold."""
    flight = Flight(case)
    try:
        flight.fly()
        if case.deaf:
            _compare(case, flight)
    except BrokenError as problem:
        return str(problem)
    return None


def _compare(case: Case, flight: Flight) -> None:
    """Frames with a wrong checksum change nothing that is commanded."""
    quiet = Flight(case)
    quiet.fly(deafened=True)
    if quiet.commands != flight.commands:
        raise BrokenError("wrong checksums changed the flight")


# ---- finding -------------------------------------------------------------------------------------


def kept(case: Case, places: Sequence[int]) -> Case:
    return replace(case, actions=tuple(case.actions[place] for place in places))


def kind_of(problem: str | None) -> str:
    """A find without its figures: two of a kind are told once."""
    return re.sub(r"[-+\d.]+(e[-+]?\d+)?|nan|inf", "#", problem or "")


def smallest(case: Case, kind: str) -> list[int]:
    """The places of few actions that break the case alike, by leaving out ever smaller parts."""
    places, part = list(range(len(case.actions))), max(1, len(case.actions) // 2)
    while part:
        at = 0
        while at < len(places):
            fewer = places[:at] + places[at + part :]
            if kind_of(broken(kept(case, fewer))) != kind:
                at += part
            else:
                places = fewer
        part //= 2
    return places


def shown(action: Action) -> str:
    if action[0] != "frame":
        return " ".join(map(str, action))
    return f"frame {action[1].hex()} ({'whole' if is_whole(action[1]) else 'wrong checksum'})"


def report(case: Case, problem: str) -> None:
    places = smallest(case, kind_of(problem))
    small = kept(case, places)
    keep = ",".join(map(str, places)) or "none"
    name = case.applet.stem
    print(f"\n{name}, {case.generation.name}: {broken(small) or problem}")
    print(*(f"  {shown(action)}" for action in small.actions), sep="\n")
    print(
        f"again: .venv/bin/python -m tests.lua.fuzz --applet {name} --case {case.number}"
        f" --keep {keep}",
        flush=True,
    )


def fuzz(applet: Path, seed: int, until_s: float, cases: int | None) -> int:
    """Fly drawn cases; the number of different finds."""
    finds: set[str] = set()
    flown = 0
    for number in count(seed * 1_000_000):
        if flown == cases or time.monotonic() > until_s or len(finds) == MOST_FINDS:
            break
        case = draw(applet, number)
        problem = broken(case)
        flown += 1
        kind = kind_of(problem)
        if problem and kind not in finds:
            finds.add(kind)
            report(case, problem)
    print(f"{applet.stem}: {flown} flights, {len(finds)} finds (seed {seed})", flush=True)
    return len(finds)


def fly_again(applet: Path, number: int, keep: str | None) -> int:
    case = draw(applet, number)
    if keep is not None:
        case = kept(case, [int(place) for place in keep.split(",") if place.isdigit()])
    print(*map(shown, case.actions), sep="\n")
    problem = broken(case)
    print(problem or "all properties hold")
    return int(problem is not None)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=60.0, help="for all applets together")
    parser.add_argument("--cases", type=int, help="so many flights of each applet instead")
    parser.add_argument("--seed", type=int, default=1)
    found = {path.stem: path for path in applets()}
    parser.add_argument("--applet", action="append", choices=found)
    parser.add_argument("--case", type=int, help="fly this one again")
    parser.add_argument("--keep", help="of its actions these alone")
    given = parser.parse_args()
    wanted = [found[name] for name in given.applet or found]
    if given.case is not None:
        return fly_again(wanted[0], given.case, given.keep)
    share_s = math.inf if given.cases else given.seconds / len(wanted)
    finds = [fuzz(one, given.seed, time.monotonic() + share_s, given.cases) for one in wanted]
    return int(any(finds))


if __name__ == "__main__":
    sys.exit(main())
