"""Ending a long-running verb: Ctrl-C, SIGTERM and a closed terminal ask it to end.

The verb finishes its work first.
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
    """Counts the requests to end; the signal handlers only write here."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> bool:
        """Whether the end was requested."""
        return self.count > 0

    def ask(self, number: int, frame: FrameType | None) -> None:
        """A signal has come."""
        self.count += 1


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Signals to end count as requests instead of ending the process.

    An ignored signal stays ignored: `nohup` keeps a verb running without its terminal. After the
    requested end the verb has done its work: another signal changes nothing.
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
