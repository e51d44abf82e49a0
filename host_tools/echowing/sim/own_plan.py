"""A plan of the user's own: a Python file that says where followers are to be, and how fast.

It takes the place of what the plan step of a tick returns (`flight.plan`), in simulated flights
only. What comes before it (who may be led, the slot, what the receivers disagree by) and after it
(the envelope, holds, guard) is as ever.
"""

import inspect
import math
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from echowing.errors import EchowingError
from echowing.flight.follower import FollowerState
from echowing.flight.guard import FIELD_LIMITS
from echowing.flight.guidance import GuidedPoint, Horizontal, LeaderFix
from echowing.flight.look import Look
from echowing.flight.plan import LEAST_MPS
from echowing.flight.session import FASTEST_MPS, FollowSession
from echowing.flight.steps import Phase, Plan
from echowing.geo import GlobalPosition, displace, ned_between

OWN_PLAN = ".py"  # how the name of a user's plan ends
FUNCTION = "plan(seen)"
# A place further away would be no plan for a follower: `FIELD_LIMITS` does not let it fly there.
FURTHEST_M = FIELD_LIMITS.max_distance_m or math.inf
EXPECTED = (
    "((north_m, east_m), (north_mps, east_mps)): a place within "
    f"{FURTHEST_M:g} m of the follower, at most {FASTEST_MPS:g} m/s"
)

# A place, from the follower, and the velocity to fly with it.
Wish = tuple[Horizontal, Horizontal]


@dataclass(frozen=True, slots=True)
class Seen:
    """What is known of a follower, for the moment at which its order reaches it.

    Places are (north, east) metres from the follower, velocities (north, east) metres per second.
    What is seen of the leader is moved by what the sonar has told of the receivers.
    """

    time_s: float
    """Of the flight."""
    system_id: int
    """The follower's."""
    own_mps: Horizontal
    """Its velocity."""
    radius_m: float
    """How far its slot is from the vehicle that its sonar looks at, as the formation says."""
    to_watched_m: Horizontal
    """To the vehicle that its sonar looks at: the leader, or another follower."""
    watched_mps: Horizontal
    """That one's velocity."""
    to_slot_m: Horizontal
    """To its slot, which is further away than `radius_m` where safety needs that."""
    slot_mps: Horizontal
    """Its slot's velocity."""
    hears: bool
    """Whether its sonar hears that vehicle."""
    sigma_m: float
    """Standard deviation of the distance to it."""
    ours: Wish
    """What our plan says."""


class OwnPlan:
    """The function of a user's file; EchowingError names the file and what is wrong with it.

    What the file keeps is its own: each one of these runs the file anew.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._plan = self._function()

    def __call__(self, seen: Seen) -> Wish:
        """What the user's function says."""
        try:
            said = self._plan(seen)
        except Exception as error:
            raise self._failed(error, f"{FUNCTION} failed after {seen.time_s:.1f} s") from error
        try:
            (north_m, east_m), (north_mps, east_mps) = said
            wish = (float(north_m), float(east_m)), (float(north_mps), float(east_mps))
        except (TypeError, ValueError, OverflowError):
            wish = ((math.nan, math.nan), (math.nan, math.nan))
        far_m, fast_mps = (math.hypot(*one) for one in wish)
        if not (far_m <= FURTHEST_M and fast_mps <= FASTEST_MPS):
            told = f"returned {said!r:.100} after {seen.time_s:.1f} s"
            raise EchowingError(f"{self._file}: {FUNCTION} {told}; expected {EXPECTED}")
        return wish

    def _function(self) -> Callable[[Seen], Any]:
        try:
            text = self._file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise EchowingError(f"{self._file}: cannot read the plan: {error}") from error
        # Not by an import: that keeps a copy, and takes it for a file changed within a second.
        module = ModuleType("own_plan")
        module.__file__ = str(self._file)
        sys.modules[module.__name__] = module  # where its own classes look for it
        try:
            exec(compile(text, str(self._file), "exec"), module.__dict__)
        except Exception as error:
            raise self._failed(error, "failed as it was read") from error
        function = getattr(module, "plan", None)
        try:
            inspect.signature(function).bind(None)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise EchowingError(
                f"{self._file}: expected a function {FUNCTION} of one argument, see LAWS.md"
            ) from None
        return function  # type: ignore[return-value]

    def _failed(self, error: Exception, when: str) -> EchowingError:
        """With the line of the file in which it was."""
        lines = [
            frame.lineno
            for frame in traceback.extract_tb(error.__traceback__)
            if frame.filename == str(self._file)
        ]
        if isinstance(error, SyntaxError):
            lines, error = [error.lineno], SyntaxError(error.msg)
        line = f", line {lines[-1]}" if lines else ""
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return EchowingError(f"{self._file}{line}: {when}: {what}")


class OwnPlanStep:
    """The plan step of a session with a user's plan in place of what ours says.

    Of followers that are led: height, nose and the distance that the applet keeps stay ours, and
    what those behind it know of its slot. Who is held stays held.
    """

    def __init__(self, own: Callable[[Seen], Wish], session: FollowSession) -> None:
        self._own, self._ours, self._known = own, session.plan, session.known

    def __call__(self, follower: FollowerState, look: Look | None, now_s: float) -> Plan | None:
        """As `Planner.plan`."""
        ours = self._ours(follower, look, now_s)
        here, guided = follower.on_arrival(now_s), follower.guided
        watched = self._known.watched_then(follower, now_s + follower.way_s)
        if None in (ours, here, guided, watched) or follower.standing.phase is not Phase.LED:
            return ours
        assert ours and here and guided and watched
        seen = _seen(follower, ours, guided, here, watched, now_s)
        (north_m, east_m), (north_mps, east_mps) = self._own(seen)
        place = displace(here, (north_m, east_m, here.alt_m - ours.place.alt_m))
        follower.guided = replace(guided, point=place, velocity_mps=(north_mps, east_mps))
        return replace(ours, place=place, velocity_mps=(north_mps or LEAST_MPS, east_mps))


def _seen(
    follower: FollowerState,
    ours: Plan,
    guided: GuidedPoint,
    here: GlobalPosition,
    watched: LeaderFix,
    now_s: float,
) -> Seen:
    """For the moment at which what is sent now reaches it."""
    north_m, east_m, _ = ned_between(here, watched.position)
    return Seen(
        time_s=now_s,
        system_id=follower.plan.system_id,
        own_mps=follower.velocity_then(now_s + follower.way_s),
        radius_m=follower.slot.radius_m,
        to_watched_m=(north_m, east_m),
        watched_mps=watched.velocity_ned_mps[:2],
        to_slot_m=ned_between(here, guided.slot)[:2],
        slot_mps=guided.slot_mps,
        hears=follower.estimate.hears(now_s),
        sigma_m=follower.estimate.offset.sigma_m(math.atan2(east_m, north_m)),
        ours=(ned_between(here, ours.place)[:2], ours.velocity_mps or (0.0, 0.0)),
    )
