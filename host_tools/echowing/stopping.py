"""Ending a long-running verb: Ctrl-C and SIGTERM ask, and the verb finishes what it has to."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Counts the requests to end; the signal handlers only ever write here."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> bool:
        """Whether the end has been asked for."""
        return self.count > 0

    def ask(self, number: int, frame: FrameType | None) -> None:
        """A signal has come."""
        self.count += 1


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """SIGINT and SIGTERM count into the request instead of ending the process."""
    request = StopRequest()
    before = {number: signal.signal(number, request.ask) for number in _SIGNALS}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
