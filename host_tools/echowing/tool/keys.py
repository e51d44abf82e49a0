"""The keys of the live view: what each does, and which of them ask first. Pure.

No key needs Enter. Keys that make vehicles move ask first and accept only `y`, pressed later than
the key itself: pasted text, or a key that is held down, is no answer.
"""

from collections.abc import Callable

from echowing.flight.orders import Orders

QUESTION_S = 5.0
YES = "y"
ESCAPE = 0x1B  # begins what arrow and function keys send


class KeyDesk:
    """Turns keys into orders; `say(now_s, text)` reports to the operator."""

    def __init__(self, orders: Orders, say: Callable[[float, str], None]) -> None:
        self._orders = orders
        self._say = say
        self._asked: tuple[float, str, Callable[[float], None]] | None = None

    def press(self, data: bytes, now_s: float) -> None:
        """Take the keys that were pressed since the last call, any number."""
        self._forget(now_s)
        for byte in data:
            if byte == ESCAPE:
                return
            self._one(chr(byte).lower(), now_s)

    def _one(self, key: str, now_s: float) -> None:
        asked, self._asked = self._asked, None
        if asked is not None:
            asked_at_s, question, order = asked
            if key == YES and now_s > asked_at_s:
                order(now_s)
                return
            self._say(now_s, f"{question} no")
        orders = self._orders
        if key in ("s", " "):
            orders.stop(now_s)
        elif key == "h":
            orders.hold(now_s)
        elif key == "b":
            orders.further(now_s)
        elif key == "e":
            self._ask_engage(now_s)
        elif key == "n":
            self._ask_nearer(now_s)
        elif key == "f":
            self._ask_reshape(now_s)

    def _ask_engage(self, now_s: float) -> None:
        orders = self._orders
        objection = orders.objection_to_engage()
        if objection is not None:
            self._say(now_s, objection)
            return
        question = "end the hold?" if orders.held else "engage: send points to all in Guided?"
        self._ask(now_s, question, orders.engage)

    def _ask_nearer(self, now_s: float) -> None:
        objection = self._orders.objection_to_nearer(now_s)
        build_up = self._orders.build_up
        if objection is not None or build_up is None:
            self._say(now_s, f"not nearer: {objection}")
            return
        question = f"nearer, from {build_up.target_m:g} to {build_up.nearer_m:g} m?"
        self._ask(now_s, question, self._orders.nearer)

    def _ask_reshape(self, now_s: float) -> None:
        objection, shape = self._orders.objection_to_reshape(), self._orders.next_shape
        if objection is not None or shape is None:
            self._say(now_s, f"no other shape: {objection}")
            return
        self._ask(now_s, f"form {shape[0]}?", self._orders.reshape)

    def _ask(self, now_s: float, question: str, order: Callable[[float], None]) -> None:
        self._asked = now_s, question, order
        self._say(now_s, f"{question} press y within {QUESTION_S:g} s")

    def _forget(self, now_s: float) -> None:
        if self._asked is not None and now_s - self._asked[0] > QUESTION_S:
            question, self._asked = self._asked[1], None
            self._say(now_s, f"{question} no answer: no")

    def line(self, now_s: float) -> str:
        """The keys and what they do now, in one line."""
        self._forget(now_s)
        if self._asked is not None:
            return f"{self._asked[1]} y: yes, any other key: no"
        build_up = self._orders.build_up
        radius = "n nearer  b back out  " if build_up is not None else ""
        shape = self._orders.next_shape
        form = "" if shape is None else f"f form {shape[0]}  "
        now = "" if build_up is None else f"  radius {build_up.radius_m:.1f} m"
        if build_up is not None and build_up.nearer_m is not None:
            now += f", next {build_up.nearer_m:g} m"
        return f"keys: e engage  h hold  {radius}{form}s stop all{now}"
