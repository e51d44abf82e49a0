"""What was said when, so that nothing is said again too soon. Pure."""

from collections.abc import Callable, Hashable

from echowing.flight.clocks import SAY_AGAIN_S

# Tells the operator: when, and what.
Say = Callable[[float, str], None]


class Said:
    """Remembers when each thing was last said."""

    def __init__(self, again_s: float = SAY_AGAIN_S) -> None:
        """again_s: before that nothing is said again."""
        self._again_s = again_s
        self._at_s: dict[Hashable, float] = {}

    def __contains__(self, what: Hashable) -> bool:
        """Whether it was ever said."""
        return what in self._at_s

    def may_say(self, what: Hashable, now_s: float) -> bool:
        """Whether to say it now; if so it counts as said."""
        if what in self and now_s - self._at_s[what] < self._again_s:
            return False
        self._at_s[what] = now_s
        return True
