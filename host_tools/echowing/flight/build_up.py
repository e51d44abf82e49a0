"""A formation that is closed in steps, and opened again, in flight. Pure.

The slots move at a limited rate; clocks, offsets and estimates stay as they are. Where the sonar
detects the leader the applet holds the follower at ECHO_DIST, whatever the slot: so ECHO_DIST is
set to the new radius first and read back; only then do the slots come nearer. Opening does not
wait. The former ECHO_DIST is restored at the end (`restore`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.clocks import ASK_PERIOD_S
from echowing.flight.engage import DIST
from echowing.flight.follower import FollowerState
from echowing.flight.guidance import Slot
from echowing.flight.known import place_guides
from echowing.flight.said import Say
from echowing.mavlink.messages import read_parameter

Followers = Mapping[int, FollowerState]

# Of the outermost slot: its follower trails it by half a metre (Guided corrects each metre of error
# with 1 m/s), and closing from 8 m to 5 m takes 6 s.
SLOT_MPS = 0.5
# Ticks come at 8 Hz; after a longer pause the slots go on from where they are.
LONGEST_STEP_S = 0.5
# Limits of ECHO_DIST in the applet (lua/echowing.lua); beyond them no sonar detects the leader.
LEAST_DIST_M, MOST_DIST_M = 1.5, 6.0
SAME_M = 0.01
# A radio loses one answer in three at its worst.
TRIES = 5
# The answer to PARAM_SET alone may only repeat the value that was sent: so it is read as well.
ANSWERS = 2


@dataclass(slots=True)
class AppletDistance:
    """ECHO_DIST of one follower, while it is set to `wanted_m`; None: nothing to set.

    before_m: its value before our first change; written_m: the last value that we set; failed: it
    was not confirmed; told: the operator was told that.
    """

    wanted_m: float | None = None
    before_m: float | None = None
    written_m: float | None = None
    failed: bool = False
    told: bool = False
    _heard_m: float | None = None
    _asks_to_set: bool = False
    _agreeing: int = 0
    _tries: int = 0
    _asked_at_s: float = -math.inf

    def want(self, distance_m: float) -> None:
        """Begin to set it; its present value is read first."""
        self.wanted_m = distance_m
        self.failed = self.told = self._asks_to_set = False
        self._heard_m, self._agreeing, self._tries = None, 0, 0
        self._asked_at_s = -math.inf

    @property
    def is_set(self) -> bool:
        """Whether the vehicle has confirmed the wanted value."""
        return self.wanted_m is None or self._agreeing >= (ANSWERS if self._asks_to_set else 1)

    @property
    def is_ours(self) -> bool:
        """Whether its value differs from before because of us."""
        changed = self.written_m is not None and self.before_m is not None
        return changed and not _same(self.written_m, self.before_m)

    def receive(self, value: float) -> None:
        """Take a PARAM_VALUE."""
        if self._heard_m is None:
            self._asked_at_s = -math.inf  # known now: continue at once
        self._heard_m = value
        if _same(value, self.wanted_m):
            self._agreeing += 1
        elif not self.is_set:
            self._agreeing = 0
        elif self.written_m is not None and not _same(value, self.written_m):
            self.before_m = self.written_m = None  # somebody else has set it: leave it

    def messages(self, system_id: int, now_s: float) -> list[Any]:
        """What to ask the vehicle now."""
        if self.wanted_m is None or self.is_set or self.failed:
            return []
        if now_s - self._asked_at_s < ASK_PERIOD_S:
            return []
        if self._tries >= TRIES:
            self.failed = True
            return []
        self._tries += 1
        self._asked_at_s = now_s
        ask = read_parameter(system_id, DIST)
        if self._heard_m is None:
            return [ask]
        if self.before_m is None:
            self.before_m = self._heard_m
        self.written_m, self._asks_to_set = self.wanted_m, True
        change = mavlink.MAVLink_param_set_message(
            system_id,
            mavlink.MAV_COMP_ID_AUTOPILOT1,
            DIST.encode(),
            self.wanted_m,
            mavlink.MAV_PARAM_TYPE_REAL32,
        )
        return [change, ask]


def _same(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and abs(a - b) < SAME_M


class BuildUp:
    """The radii of one flight, the widest first; `slots` are the formation's at the widest.

    A radius is the nearest slot's distance from the leader; the others keep their proportion.
    radius_m: where the slots are now.
    """

    def __init__(self, radii_m: Sequence[float], slots: Sequence[Slot]) -> None:
        self.radii_m = tuple(radii_m)
        self.radius_m = self.radii_m[0]
        self._slots = list(slots)
        radii = [slot.radius_m for slot in slots]
        self._spread = max(radii) / min(radii)
        self._step = 0
        self._waits = False
        self._told = True
        self._at_s: float | None = None
        self.distances: dict[int, AppletDistance] = {}

    @property
    def target_m(self) -> float:
        """The radius to reach."""
        return self.radii_m[self._step]

    @property
    def nearer_m(self) -> float | None:
        """The next radius; None: there is none."""
        more = self._step + 1 < len(self.radii_m)
        return self.radii_m[self._step + 1] if more else None

    @property
    def further_m(self) -> float | None:
        """The radius before; None: there is none."""
        return self.radii_m[self._step - 1] if self._step > 0 else None

    @property
    def moves(self) -> bool:
        """Whether the slots have not yet reached the target radius."""
        return self._waits or self.radius_m != self.target_m

    def objection(
        self,
        followers: Followers,
        led: Sequence[FollowerState],
        objection_to_radius: Callable[[FollowerState, float], str | None],
    ) -> str | None:
        """Why the slots cannot come nearer now; None: they can.

        led: followers that get points; objection_to_radius: as before engaging (see `engage`).
        """
        if self.nearer_m is None:
            return f"{self.target_m:g} m is the last radius of --build-up"
        if self.moves:
            return f"still on the way to {self.target_m:g} m"
        if not led:
            return "nobody is led yet"
        for follower in led:
            if follower.standing.held:
                return f"follower {follower.plan.system_id} holds: {follower.standing.why}"
        slots = scaled(self._slots, self.nearer_m)
        for follower, slot in zip(followers.values(), slots, strict=True):
            text = objection_to_radius(follower, slot.radius_m)
            if text is not None:
                return f"follower {follower.plan.system_id}: {text}"
        return None

    def nearer(self, followers: Followers) -> None:
        """Aim at the next radius: the applets' distance first, the slots once that is confirmed."""
        if self.nearer_m is not None:
            self._aim(followers, self._step + 1)
            self._waits = True

    def further(self, followers: Followers) -> None:
        """Aim at the radius before, at once."""
        if self.further_m is not None:
            self._aim(followers, self._step - 1)
            self._waits = False

    def _aim(self, followers: Followers, step: int) -> None:
        self._step, self._told = step, False
        slots = scaled(self._slots, self.target_m)
        for system_id, slot in zip(followers, slots, strict=True):
            wanted_m = min(MOST_DIST_M, max(LEAST_DIST_M, slot.radius_m))
            self.distances.setdefault(system_id, AppletDistance()).want(wanted_m)

    def receive(self, message: Any) -> None:
        """Take any message of a vehicle of the session."""
        if message.get_type() != "PARAM_VALUE" or message.param_id != DIST:
            return
        distance = self.distances.get(message.get_srcSystem())
        if distance is not None:
            distance.receive(message.param_value)

    def advance(self, followers: Followers, say: Say, now_s: float) -> list[tuple[int, Any]]:
        """Once a tick: move the slots; returns what to send. say(now_s, text): to the operator."""
        elapsed_s = 0.0 if self._at_s is None else now_s - self._at_s
        self._at_s = now_s
        messages = []
        for system_id, distance in self.distances.items():
            untouched = not distance.is_ours
            messages += [(system_id, one) for one in distance.messages(system_id, now_s)]
            if untouched and distance.is_ours:
                text = f"{DIST} was {distance.before_m:g} and is put back at the end"
                say(now_s, f"follower {system_id}: {text}")
        self._judge(followers, say, now_s)
        if not self._waits and self.radius_m != self.target_m:
            step_m = SLOT_MPS / self._spread * min(elapsed_s, LONGEST_STEP_S)
            far_m = self.target_m - self.radius_m
            self.radius_m += math.copysign(min(step_m, abs(far_m)), far_m)
            self._place(followers)
        if not self.moves and not self._told:
            self._told = True
            say(now_s, f"radius {self.target_m:g} m")
        return messages

    def _judge(self, followers: Followers, say: Say, now_s: float) -> None:
        """Let the slots come nearer once every applet has confirmed, or go back where one fails."""
        failed = [(who, one) for who, one in self.distances.items() if one.failed and not one.told]
        for system_id, one in failed:
            one.told = True
            say(now_s, f"follower {system_id}: {DIST} {one.wanted_m:g} is not confirmed")
        if not self._waits:
            return
        if failed:
            self.further(followers)
            say(now_s, f"the radius stays {self.target_m:g} m")
        elif all(distance.is_set for distance in self.distances.values()):
            self._waits = False

    def _place(self, followers: Followers) -> None:
        slots = scaled(self._slots, self.radius_m)
        for follower, slot in zip(followers.values(), slots, strict=True):
            # Who has moved up (`gaps`) is in another slot of its line, of the same radius.
            follower.plan.slot = replace(follower.plan.slot, radius_m=slot.radius_m)
        place_guides(followers.values())

    # ---- the end --------------------------------------------------------------------------------

    def restore(self) -> None:
        """Begin to restore the former ECHO_DIST."""
        for distance in self.distances.values():
            if distance.is_ours and distance.before_m is not None:
                distance.want(distance.before_m)
            else:
                distance.wanted_m = None

    @property
    def restored(self) -> bool:
        """Whether each ECHO_DIST is restored, or has failed."""
        return all(distance.is_set or distance.failed for distance in self.distances.values())

    def left(self) -> list[tuple[str, bool]]:
        """A text for each ECHO_DIST that was changed, and whether it is restored."""
        texts = []
        for system_id, distance in self.distances.items():
            if distance.wanted_m is None:
                continue
            text = f"follower {system_id}: {DIST} put back to {distance.wanted_m:g}"
            if not distance.is_set:
                text = (
                    f"follower {system_id}: {DIST} NOT put back: "
                    f"param set {DIST} {distance.wanted_m:g}"
                )
            texts.append((text, distance.is_set))
        return texts


def scaled(slots: Sequence[Slot], radius_m: float) -> list[Slot]:
    """A formation's slots, the nearest of them `radius_m` from the leader."""
    share = radius_m / min(slot.radius_m for slot in slots)
    return [replace(slot, radius_m=share * slot.radius_m) for slot in slots]
