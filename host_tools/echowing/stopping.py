"""Ending a long-running verb: Ctrl-C, SIGTERM and a closed terminal ask it to end.

The verb finishes its work first.
"""

import signal
import threading
from collections.abc import Callable, Iterator
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


@contextmanager
def waiting_interrupts() -> Iterator[Callable[[], None]]:
    """Ctrl-C waits for a call of what this yields, which then raises KeyboardInterrupt.

    For work that calls back from C. An exception that arises as a callback begins is lost: the
    applet's pcall takes it for its own error, ctypes prints it and goes on. Where Ctrl-C does not
    raise KeyboardInterrupt, it stays as it is.
    """
    request = StopRequest()

    def raise_asked() -> None:
        if request():
            raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield raise_asked
        return
    signal.signal(signal.SIGINT, request.ask)
    try:
        yield raise_asked
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    raise_asked()


def ignore_signals() -> None:
    """The process is ending, and its exit code is known: no signal changes it any more."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
