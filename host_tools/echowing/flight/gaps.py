"""Who takes the slot of a follower that is not led any more. Pure.

Who ranges it holds, and so does everybody behind. Where gaps are closed, one of them takes its
slot, the next one takes that one's, and so on to the end of the line. The last slot then belongs to
the one that has left, once its pilot brings it back.
"""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.follower import FollowerState
from echowing.flight.known import Known
from echowing.flight.said import Say

NOTICE = mavlink.MAV_SEVERITY_NOTICE
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

    def close(self, now_s: float, *, reshapes: bool = False) -> None:
        """Let who is behind one that has left move up; once a tick.

        reshapes: the formation is on its way into another shape, and gaps wait.
        """
        followers = list(self._known.followers.values())
        led = [one for one in followers if one.standing.sent_to]
        if not led:  # the flight is over, or has not begun
            self._led_at_s.clear()
        for one in led:
            self._led_at_s[one.plan.system_id] = now_s
        for one in () if reshapes else reversed(followers):
            if now_s - self._led_at_s.get(one.plan.system_id, math.inf) >= LEAVES_S:
                self._close(one, now_s)

    def _close(self, left: FollowerState, now_s: float) -> None:
        line = [left, *self._line_behind(left)]
        if len(line) == 1:
            return
        self._known.move_up(line)
        # Nobody flies back past the others by itself, as a link comes back.
        left.turn.latched = "its slot was taken, until it leaves Guided"
        self._alert(left.plan.system_id, "its slot is the last one now", NOTICE)
        for ahead, one in pairwise(line):
            text = f"takes the slot of follower {ahead.plan.system_id}"
            self._alert(one.plan.system_id, text, NOTICE)
            self._say(now_s, f"follower {one.plan.system_id}: {text}, which has left")

    def _line_behind(self, one: FollowerState) -> Iterator[FollowerState]:
        """The first that ranges it and may be led, the first that ranges that one, and so on."""
        behind = (
            other
            for other in self._known.behind(one)
            # Who was stopped for another reason stays where it is.
            if other.standing.sent_to and other.turn.latched is None
        )
        follower = next(behind, None)
        if follower is not None:
            yield follower
            yield from self._line_behind(follower)
