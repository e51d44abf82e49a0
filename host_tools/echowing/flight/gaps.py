"""Who takes the slot of a follower that is not led any more. Pure.

Who ranges it holds, and so does everybody behind. Where gaps are closed, one of them takes its
slot, the next one takes that one's, and so on to the end of the line. The last slot then belongs to
the one that has left, should its pilot bring it back.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.flight.guidance import Slot
from echowing.flight.state import FollowerState, Known, Say

# A pilot who takes a follower for a moment, or a radio that is silent for one, leaves no gap.
LEAVES_S = 5.0


class Gaps:
    """Closes gaps in the formation of one session.

    say(now_s, text) is for the operator, alert(system_id, text, severity) for a follower's pilot.
    """

    def __init__(self, known: Known, say: Say, alert: Callable[..., None]) -> None:
        self._known, self._say, self._alert = known, say, alert
        self._led_at_s: dict[int, float] = {}
        """When each that was led at any time was led last."""

    def close(self, now_s: float) -> None:
        """Let who is behind one that has left move up; once a tick."""
        followers = list(self._known.followers.values())
        for one in followers:
            if one.standing.sent_to:
                self._led_at_s[one.plan.system_id] = now_s
        for one in reversed(followers):
            if now_s - self._led_at_s.get(one.plan.system_id, math.inf) >= LEAVES_S:
                self._close(one, now_s)

    def _close(self, left: FollowerState, now_s: float) -> None:
        line = [left, *self._line_behind(left)]
        if len(line) == 1:
            return
        self._known.move_up(line)
        line[1].turn.joined, line[1].turn.joins_at_s = False, math.inf
        for ahead, one in pairwise(line):
            text = f"takes the slot of follower {ahead.plan.system_id}"
            self._alert(one.plan.system_id, text, mavlink.MAV_SEVERITY_NOTICE)
            self._say(now_s, f"follower {one.plan.system_id}: {text}, which has left")

    def _line_behind(self, one: FollowerState) -> Iterator[FollowerState]:
        """The first that is led and ranges it, the first that ranges that one, and so on."""
        behind = (
            other
            for other in self._known.followers.values()
            if self._known.ahead_of(other) is one and other.standing.sent_to
        )
        follower = next(behind, None)
        if follower is not None:
            yield follower
            yield from self._line_behind(follower)


def check_gaps(slots: Sequence[Slot]) -> None:
    """Raise EchowingError unless a follower may take any other slot of its line.

    Its applet holds it at `ECHO_DIST` from whom it ranges, which no one changes in flight.
    """
    for number, slot in enumerate(slots, 1):
        ahead = None if slot.behind is None else slots[slot.behind]
        if ahead is not None and slot.radius_m != ahead.radius_m:
            raise EchowingError(
                f"gaps cannot close: slot {number} has a radius of {slot.radius_m:g} m, and slot "
                f"{(slot.behind or 0) + 1}, behind which it is, of {ahead.radius_m:g} m; give both "
                "the same"
            )
