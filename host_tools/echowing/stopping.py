"""Ending a long-running verb: Ctrl-C, SIGTERM and a closed terminal ask it to end.

The verb finishes its work first.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from echowing.errors import EchowingError

# Windows knows no hang-up.
_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class NotHeededError(EchowingError):
    """Nobody has looked at a request to end: what was going on is interrupted."""


class StopRequest:
    """Counts the requests to end; the signal handlers only write here.

    patience_s: a request that nobody has looked at for so long interrupts what is going on; None:
    it waits.
    """

    def __init__(self, patience_s: float | None = None) -> None:
        self._count = self._heeded = 0
        self._patience_s = patience_s

    @property
    def count(self) -> int:
        """How often the end was requested."""
        self._heeded = self._count
        return self._count

    @count.setter
    def count(self, count: int) -> None:
        self._count = count

    def __call__(self) -> bool:
        """Whether the end was requested."""
        return self.count > 0

    def ask(self, number: int, frame: FrameType | None) -> None:
        """A signal has come."""
        self._count += 1
        if self._patience_s is not None:
            signal.setitimer(signal.ITIMER_REAL, self._patience_s)

    def insist(self, number: int, frame: FrameType | None) -> None:
        """The time is over in which a request should have been looked at."""
        if self._patience_s is not None and self._heeded < self._count:
            raise NotHeededError(f"no answer to Ctrl-C for {self._patience_s:g} s: interrupted")

    def be_patient(self) -> None:
        """Interrupt nothing any more: what is left takes its time."""
        self._patience_s = None


@contextmanager
def stop_on_signals(patience_s: float | None = None) -> Iterator[StopRequest]:
    """Signals to end count as requests instead of ending the process.

    With `patience_s` a request that nobody has looked at for so long raises NotHeededError where
    the process is: a loop that does not end can be ended too (not on Windows).

    An ignored signal stays ignored: `nohup` keeps a verb running without its terminal. After the
    requested end the verb has done its work: another signal changes nothing.
    """
    has_timer = hasattr(signal, "setitimer")
    request = StopRequest(patience_s if has_timer else None)
    heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, request.ask) for number in heeded}
    if has_timer and patience_s is not None:
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, request.insist)
    try:
        yield request
    finally:
        request.be_patient()
        if has_timer and patience_s is not None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
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
