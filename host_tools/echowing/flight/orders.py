"""What the operator orders in flight: engage, hold, come nearer, back out, another shape, stop all.

Pure.

`prepare` is called before each tick of the session. `engage` ends a hold; nothing ends a stop.
Neither affects a follower that its pilot flies by hand.
"""

from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.build_up import BuildUp
from echowing.flight.follower import FollowerState
from echowing.flight.reshape import Named
from echowing.flight.session import FollowSession

HELD = "held by the operator"
STOPPED = "stopped by the operator"


class Orders:
    """The operator's orders to one session.

    build_up None: the radius stays; shapes: that it takes one after the other, the first once more
    after the last.
    """

    def __init__(
        self,
        session: FollowSession,
        build_up: BuildUp | None = None,
        shapes: Sequence[Named] = (),
    ) -> None:
        self.build_up = build_up
        self._shapes, self._in_shape = shapes, 0
        self.held = self.stopped = False
        self._session = session

    def receive(self, message: Any) -> None:
        """Take any message of a vehicle of the session."""
        if self.build_up is not None:
            self.build_up.receive(message)

    def prepare(self, now_s: float) -> list[tuple[int, Any]]:
        """Once before each tick: apply what was ordered; returns what to send."""
        for follower in self._session.followers.values():
            # The hold also applies to a follower whose pilot comes back to Guided meanwhile.
            if self.held and follower.turn.latched is None:
                follower.turn.latched = HELD
        if self.build_up is None:
            return []
        return self.build_up.advance(self._session.followers, self._say, now_s)

    # ---- orders ---------------------------------------------------------------------------------

    def objection_to_engage(self) -> str | None:
        """Why `engage` would do nothing; None: it would."""
        if self.stopped:
            return "all were stopped: end this tool and start it anew to engage"
        return "engaged already" if self._session.engaged and not self.held else None

    def engage(self, now_s: float) -> None:
        """Send points to the followers that pass their checks; ends a hold."""
        session, objection = self._session, self.objection_to_engage()
        if objection is not None:
            self._say(now_s, objection)
        elif self.held:
            self.held = False
            for follower in session.followers.values():
                if follower.turn.latched == HELD:
                    follower.turn.latched = None
            self._say(now_s, "hold ended by key")
        else:
            session.engage()
            self._say(now_s, "engaged by key: points go to followers that fly in Guided")
            self._show_pilots("engaged by its operator")

    def hold(self, now_s: float) -> None:
        """Hold every follower where it is until `engage`."""
        if self.stopped or not self._session.engaged:
            self._say(now_s, f"no hold: {'all stopped' if self.stopped else 'not engaged'}")
        elif not self.held:
            self.held = True
            self._say(now_s, "hold by key: every follower that is led holds until e")

    def stop(self, now_s: float) -> None:
        """Stop every follower that is led, and every take-off, for good."""
        if not self.stopped:
            self.stopped = True
            self._session.stop(STOPPED)
            self._say(now_s, "STOP by key: all that were moved hold, for good")

    def nearer(self, now_s: float) -> None:
        """Go to the next radius of the build-up."""
        objection = self.objection_to_nearer(now_s)
        if objection is not None or self.build_up is None:
            self._say(now_s, f"not nearer: {objection}")
            return
        self.build_up.nearer(self._session.followers)
        self._say_radius(now_s, "nearer", self.build_up)

    def further(self, now_s: float) -> None:
        """Back out to the radius before."""
        if self.build_up is None or self.build_up.further_m is None:
            self._say(now_s, "not further: there is no wider radius (--build-up)")
            return
        self.build_up.further(self._session.followers)
        self._say_radius(now_s, "back out", self.build_up)

    @property
    def next_shape(self) -> Named | None:
        """The shape that `reshape` lets them fly into; None: there is one only."""
        several = len(self._shapes) > 1
        return self._shapes[(self._in_shape + 1) % len(self._shapes)] if several else None

    def objection_to_reshape(self) -> str | None:
        """Why the shape cannot change now; None: it can."""
        shape = self.next_shape
        if shape is None:
            return "one shape only was given (--formation column,vee)"
        if self.stopped or self.held or not self._session.engaged:
            return "not engaged"
        return self._session.reshape.objection(shape)

    def reshape(self, now_s: float) -> None:
        """Let all fly into the next shape."""
        objection, shape = self.objection_to_reshape(), self.next_shape
        if objection is not None or shape is None:
            self._say(now_s, f"no other shape: {objection}")
            return
        self._in_shape = (self._in_shape + 1) % len(self._shapes)
        self._session.reshape.begin(shape, now_s)
        self._show_pilots(f"to {shape[0]}")

    def objection_to_nearer(self, now_s: float) -> str | None:
        """Why they cannot come nearer now; None: they can."""
        if self.build_up is None:
            return "no --build-up was given"
        if self.stopped or self.held or not self._session.engaged:
            return "not engaged"
        session = self._session
        led = [one for one in session.followers.values() if one.standing.sent_to]
        return self.build_up.objection(session.followers, led, self._objection_to_radius)

    def _objection_to_radius(self, follower: FollowerState, radius_m: float) -> str | None:
        engagement = self._session.engagement
        return None if engagement is None else engagement.objection_to_radius(follower, radius_m)

    def _say_radius(self, now_s: float, how: str, build_up: BuildUp) -> None:
        text = f"{how}, to {build_up.target_m:g} m"
        self._say(now_s, f"{text} by key")
        self._show_pilots(text)

    def _show_pilots(self, text: str) -> None:
        for system_id, follower in self._session.followers.items():
            if follower.in_guided:
                self._session.alert(system_id, text, mavlink.MAV_SEVERITY_NOTICE)

    def _say(self, now_s: float, text: str) -> None:
        self._session.events.append((now_s, text))
