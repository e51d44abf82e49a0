"""Fuzz the follow session:  python -m tests.flight.session_fuzz [--seconds S] [--seed N].

A leader flies, two followers are led after it, and their messages are mutated, sent twice, held
back, cut, and invented under their ids. All go as bytes through the parser and the door into a
session, as a link hands them on. Nothing may make a tick fail or run without an end, and no point
that is not finite, or far from where its follower is believed to be, may leave. A find is printed
with the seed that flies it again.
"""

import argparse
import faulthandler
import math
import random
import struct
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import replace
from types import FrameType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.flight.yard import FOLLOWER, HERE, LEADER, POINT, SECOND, TICK_S, Vehicle

from echowing.flight.follower import FollowerPlan
from echowing.flight.guard import FIELD_LIMITS
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.session import FollowSession
from echowing.flight.switch import StopSwitch
from echowing.geo import GlobalPosition, displace, distance_m, ned_between
from echowing.mavlink.plausible import FIELDS, Door
from echowing.mavlink.signing import Parser
from echowing.sonar_file import shipped_sonar

FLIGHT_S = 20.0
IDS = (LEADER, FOLLOWER, SECOND)
SLOTS = {FOLLOWER: Slot(3.0), SECOND: Slot(8.0)}
# A tick of two followers takes a tenth of this; one of its lines in a loop without an end, all.
MOST_STEPS = 100_000
COUNTED_EVERY = 20
# The greatest distance from the leader (100 m), and a slot that is as far again as the widest.
FAR_M = 150.0
FAST_MPS = 30.0
SPEED_MPS = 4.0
HANGS_S = 600.0
NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-30, -1e-30, 3.4e38, -3.4e38, 1.0, -1.0)
BYTES = {"float": 4, "double": 8, "uint64_t": 8, "int64_t": 8, "uint32_t": 4, "int32_t": 4}
KINDS = {one.msgname: one for one in mavlink.mavlink_map.values()}


class FindError(Exception):
    """A property that does not hold."""


class Fuzz:
    """One flight, by its seed."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.now_s = 0.0
        self.vehicles = {
            LEADER: Vehicle((0.0, 0.0), velocity_mps=(2.0, 0.0)),
            FOLLOWER: Vehicle((-4.0, 0.0)),
            SECOND: Vehicle((-9.0, 1.0)),
        }
        plans = [
            FollowerPlan(system_id, slot, sonar=shipped_sonar())
            for system_id, slot in SLOTS.items()
        ]
        switch = StopSwitch(7, 1700) if self.chance.random() < 0.3 else None
        limits = replace(FIELD_LIMITS, switch=switch)
        self.session = FollowSession(LEADER, plans, GuidanceSettings(), limits=limits)
        self.door = Door()
        self.parser = Parser()
        self.hostility = self.chance.choice((0.02, 0.1, 0.5))
        self.held_back: list[tuple[float, bytes]] = []
        self.recent: list[tuple[int, Any]] = []
        self.points = 0
        self.injects_from_s = self.chance.uniform(0.0, 10.0)
        self.ends_at_s = self.chance.uniform(5.0, 3.0 * FLIGHT_S)

    def fly(self) -> None:
        """Fly it. Raises FindError, or what the session raises."""
        for step in range(round(FLIGHT_S / TICK_S)):
            self.now_s += TICK_S
            for data in self._on_the_wire():
                self._hear(data)
            if self.now_s >= self.ends_at_s:
                self.session.stop("the tool ends")
                self.session.stopped()
            if step % COUNTED_EVERY == 0:
                with_limit = Counted()
                sent = with_limit.run(self.session, self.now_s)
            else:
                sent = self.session.tick(self.now_s)
            for system_id, message in sent:
                self._check(system_id, message)
                for answer in self.vehicles[system_id].answer(message, self.now_s):
                    self._queue(system_id, answer)

    # ---- what the vehicles say ------------------------------------------------------------------

    def _on_the_wire(self) -> Iterator[bytes]:
        due = [data for at_s, data in self.held_back if at_s <= self.now_s]
        self.held_back = [one for one in self.held_back if one[0] > self.now_s]
        yield from due
        for system_id, vehicle in self.vehicles.items():
            self._move(vehicle)
            for message in self._reports(system_id, vehicle):
                yield from self._spoiled(system_id, message)
        if self.now_s > self.injects_from_s:
            while self.chance.random() < self.hostility:
                yield self._invented()

    def _reports(self, system_id: int, vehicle: Vehicle) -> Iterator[Any]:
        yield vehicle.position(self.now_s)
        if system_id != LEADER:
            range_m = 2.8 + 0.01 * self.chance.randrange(9) if system_id == FOLLOWER else 7.66
            boot_ms = vehicle.boot_ms(self.now_s)
            yield mavlink.MAVLink_named_value_float_message(boot_ms, b"SNR_RAW", range_m)
        if round(self.now_s / TICK_S) % 8 == 1:
            yield from vehicle.reports(self.now_s)
            pulses = [1500] * 18
            yield mavlink.MAVLink_rc_channels_message(vehicle.boot_ms(self.now_s), 18, *pulses, 255)

    def _queue(self, system_id: int, message: Any) -> None:
        for data in self._spoiled(system_id, message):
            self.held_back.append((self.now_s + TICK_S, data))

    def _spoiled(self, system_id: int, message: Any) -> Iterator[bytes]:
        """A message as it arrives: whole, or lost, twice, late, cut, with a flipped bit."""
        self.recent = [*self.recent[-30:], (system_id, message)]
        data = _packed(system_id, message)
        draw = self.chance.random() / self.hostility
        if self.now_s < self.injects_from_s or draw > 1.0:
            yield data
        elif draw < 0.2:
            self.held_back.append((self.now_s + self.chance.expovariate(1.0), data))
        elif draw < 0.4:
            yield data + data
        elif draw < 0.6:
            yield data[: self.chance.randrange(len(data))]
        elif draw < 0.8:
            flipped = bytearray(data)
            flipped[self.chance.randrange(len(data))] ^= 1 << self.chance.randrange(8)
            yield bytes(flipped)

    def _invented(self) -> bytes:
        """A whole message that nobody should have sent."""
        chance = self.chance
        if self.recent and chance.random() < 0.6:
            system_id, message = chance.choice(self.recent)
        else:
            system_id, message = chance.choice(IDS), _of_kind(chance, chance.choice(sorted(FIELDS)))
        system_id = system_id if chance.random() < 0.8 else chance.choice((*IDS, 7))
        component = 1 if chance.random() < 0.9 else chance.choice((0, 154, 191, 255))
        for _ in range(chance.choice((1, 1, 1, 3))):
            _mutate(chance, message)
        return _packed(system_id, message, component)

    def _move(self, vehicle: Vehicle) -> None:
        north_m, east_m = vehicle.at_m
        north_mps, east_mps = vehicle.velocity_mps
        vehicle.at_m = north_m + north_mps * TICK_S, east_m + east_mps * TICK_S

    # ---- what the session makes of it -----------------------------------------------------------

    def _hear(self, data: bytes) -> None:
        for message in self.parser.parse_buffer(data) or ():
            if message.get_msgId() >= 0 and self.door.admits(message):
                self.session.receive(message, self.now_s)

    def _check(self, system_id: int, message: Any) -> None:
        _packed(245, message)
        if message.get_type() != POINT:
            return
        self.points += 1
        numbers = [getattr(message, name) for name in message.get_fieldnames()]
        if not all(map(math.isfinite, numbers)):
            raise FindError(f"{message} is not finite")
        point = GlobalPosition(message.lat_int / 1e7, message.lon_int / 1e7, 0.0)
        follower = self.session.followers[system_id]
        here = follower.position
        if here is None:
            raise FindError(f"{message} to a follower that has not reported")
        if distance_m(here._replace(alt_m=0.0), point) > FAR_M:
            raise FindError(f"{message} is far from {here}")
        if not -10.0 <= message.alt <= 1_000.0:
            raise FindError(f"{message} is no height")
        if math.hypot(message.vx, message.vy) > FAST_MPS:
            raise FindError(f"{message} is too fast")
        self._fly_to(self.vehicles[system_id], point)

    def _fly_to(self, vehicle: Vehicle, point: GlobalPosition) -> None:
        there = displace(HERE, (*vehicle.at_m, 0.0))
        north_m, east_m, _ = ned_between(there._replace(alt_m=0.0), point)
        far_m = math.hypot(north_m, east_m)
        share = min(1.0, SPEED_MPS / far_m) if far_m > 0.0 else 0.0
        vehicle.velocity_mps = north_m * share, east_m * share


class Counted:
    """Counts the lines of a tick, so that one without an end ends on every machine alike."""

    def __init__(self) -> None:
        self.steps = 0

    def run(self, session: FollowSession, now_s: float) -> list[tuple[int, Any]]:
        """Tick. Raises FindError after too many lines."""
        before = sys.gettrace()
        sys.settrace(self._trace)
        try:
            return session.tick(now_s)
        finally:
            sys.settrace(before)

    def _trace(self, frame: FrameType, event: str, argument: object) -> Any:
        self.steps += 1
        if self.steps > MOST_STEPS:
            raise FindError(f"a tick of more than {MOST_STEPS} lines, in {frame.f_code.co_name}")
        return self._trace


def _packed(system_id: int, message: Any, component: int = 1) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
    return bytes(message.pack(sender))


def _of_kind(chance: random.Random, kind: str) -> Any:
    """A message of a kind whose payload is drawn."""
    shape = KINDS[kind]
    size = struct.calcsize(shape.unpacker.format)
    payload = bytes(chance.choice((0, 0, 255, chance.randrange(256))) for _ in range(size))
    header = struct.pack("<BBBBBBBHB", 0xFD, size, 0, 0, 0, 1, 1, shape.id & 0xFFFF, 0)
    crc = mavlink.x25crc(header[1:] + payload)
    crc.accumulate(struct.pack("B", shape.crc_extra))
    return mavlink.MAVLink(None).decode(bytearray(header + payload + struct.pack("<H", crc.crc)))


def _mutate(chance: random.Random, message: Any) -> None:
    """Change one field: a special number, or a bit of it, or a little."""
    kind = KINDS[message.get_type()]
    index = chance.randrange(len(kind.fieldnames))
    name, sort = kind.fieldnames[index], kind.fieldtypes[index]
    value = getattr(message, name)
    if isinstance(value, bytes | str | list):
        return
    if sort in ("float", "double"):
        near = value + chance.choice((-1.0, 1.0)) * chance.choice((0.1, 1.0, 50.0))
        setattr(message, name, chance.choice((*NUMBERS, near, near)))
        return
    bits = 8 * BYTES.get(sort, 2 if "16" in sort else 1)
    low = 0 if sort.startswith("u") else -(2 ** (bits - 1))
    high = low + 2**bits - 1
    near = value + chance.choice((-1, 1)) * chance.choice((1, 100, 1_000, 10_000, 100_000))
    flipped = value ^ 1 << chance.randrange(bits - 1)
    drawn = chance.choice((low, high, 0, near, near, near, flipped))
    setattr(message, name, max(low, min(high, drawn)))


def main() -> int:
    """Fuzz until the time is over; 1: a find."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1, help="the first flight's")
    parser.add_argument("--one", action="store_true", help="only this seed")
    args = parser.parse_args()
    until_s, seed, points = time.monotonic() + args.seconds, args.seed, 0
    while time.monotonic() < until_s:
        # A tick that hangs between the counted ones; a flight takes a second.
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        flight = Fuzz(seed)
        try:
            flight.fly()
        except Exception:
            traceback.print_exc()
            print(f"again: python -m tests.flight.session_fuzz --one --seed {seed}")
            return 1
        points += flight.points
        seed += 1
        if args.one:
            break
    faulthandler.cancel_dump_traceback_later()
    print(f"the session: {seed - args.seed} flights, {points} points, nothing found")
    return 0


if __name__ == "__main__":
    sys.exit(main())
