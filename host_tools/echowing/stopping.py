"""Ending a long-running verb: Ctrl-C, SIGTERM and a closed terminal ask.

The verb finishes what it has to.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Windows knows no hang-up.
_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


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
    """Signals to end count into the request instead of ending the process.

    One that is to be ignored stays so: `nohup` keeps a verb going without its terminal. Where the
    end was asked for, the verb has done what it had to: a further signal changes nothing.
    """
    request = StopRequest()
    heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, request.ask) for number in heeded}
    try:
        yield request
    finally:
        if request():
            ignore_signals()
        else:
            for number, handler in before.items():
                signal.signal(number, handler)


def ignore_signals() -> None:
    """The process is ending, and its exit code is known: no signal changes it any more."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
