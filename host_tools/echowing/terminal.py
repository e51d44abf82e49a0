"""What the terminal can do."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from typing import Any

# Rich draws nothing on these until the end (Console.is_dumb_terminal).
_WITHOUT_CURSOR = ("dumb", "unknown")


def draws_live() -> bool:
    """Whether stdout is a terminal that can redraw a picture."""
    return sys.stdout.isatty() and os.environ.get("TERM", "").lower() not in _WITHOUT_CURSOR


def ring() -> None:
    """Ring the bell of the terminal, if there is one."""
    if sys.stderr.isatty():
        sys.stderr.write("\a")
        sys.stderr.flush()


def run_in_flight(
    run: Callable[[], int], stuck: Callable[[], bool], keyboard: "Keyboard | None" = None
) -> int:
    """Run a flying tool on this process's terminal, so that the terminal cannot stop it.

    If the terminal still accepts nothing at the end (`stuck`), the process ends without it.
    keyboard: what the tool reads keys from, if it does. Returns the tool's exit code.
    """
    code = 1
    try:
        with flying_terminal(), keyboard or nullcontext():
            code = run()
    finally:
        if stuck():
            os._exit(code)
    return code


@contextmanager
def flying_terminal() -> Iterator[None]:
    """In flight no key stops the process: neither Ctrl-S (XOFF) nor Ctrl-Z.

    SIGQUIT requests the end, as SIGTERM does. Everything is restored at the end.
    """
    with ExitStack() as stack:
        if (quit_number := getattr(signal, "SIGQUIT", None)) is not None:
            ask = signal.getsignal(signal.SIGTERM) or signal.SIG_DFL
            stack.callback(signal.signal, quit_number, signal.signal(quit_number, ask))
        for name in ("SIGTSTP", "SIGTTIN", "SIGTTOU"):  # Windows knows none of them
            if (number := getattr(signal, name, None)) is not None:
                stack.callback(signal.signal, number, signal.signal(number, signal.SIG_IGN))
        for device in {_device(number) for number in (0, 1, 2)} - {None}:
            _without_flow_control(str(device), stack)
        yield


def _device(number: int) -> str | None:
    """The terminal at a file descriptor, None where there is none."""
    try:
        return os.ttyname(number)
    except (OSError, AttributeError):
        return None


def _without_flow_control(device: str, stack: ExitStack) -> None:
    """Disable XOFF on a terminal; the stack restores it."""
    try:
        import termios  # noqa: PLC0415 (not on Windows)

        number = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except (ImportError, OSError):
        return
    stack.callback(os.close, number)
    before = termios.tcgetattr(number)
    _take_off_xoff(number)
    stack.callback(termios.tcsetattr, number, termios.TCSANOW, before)


def _take_off_xoff(number: int) -> None:
    import termios  # noqa: PLC0415 (not on Windows)

    without = termios.tcgetattr(number)
    without[0] &= ~termios.IXON
    termios.tcsetattr(number, termios.TCSANOW, without)


class Keyboard:
    """Single keys of this process's terminal, without Enter and without an echo.

    As a context: the terminal is restored at the end. `read` never waits: neither for a key nor
    for a terminal that accepts nothing. In the background (`&`, `bg`) the terminal is the shell's:
    nothing is read or set; after `fg` it is ours again.
    """

    def __init__(self, number: int = 0) -> None:
        """`number`: file descriptor of the terminal."""
        self._device = _device(number)
        self._number: int | None = None
        self._stack = ExitStack()

    @property
    def is_there(self) -> bool:
        """Whether there is a terminal to press keys on (on Windows none is read)."""
        return self._device is not None

    def __enter__(self) -> "Keyboard":
        try:
            import termios  # noqa: PLC0415 (not on Windows)

            # Opened again, because the shell shares the settings of standard input.
            number = os.open(str(self._device), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except (ImportError, OSError):
            return self
        self._number = number
        self._stack.callback(os.close, number)
        self._stack.callback(self._put_back, termios.tcgetattr(number))
        before = signal.signal(signal.SIGCONT, lambda *_: self._take())
        self._stack.callback(signal.signal, signal.SIGCONT, before)
        self._take()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        self._number = None

    def read(self) -> bytes:
        """The keys since the last call, as the terminal sends them."""
        if self._number is None or not _in_foreground(self._number):
            return b""
        try:
            return os.read(self._number, 256)
        except OSError:
            return b""

    def _take(self) -> None:
        import termios  # noqa: PLC0415 (not on Windows)
        import tty  # noqa: PLC0415

        if self._number is not None and _in_foreground(self._number):
            # At once: waiting for pending output could last for ever.
            tty.setcbreak(self._number, termios.TCSANOW)
            _take_off_xoff(self._number)
            # Keys typed before were not meant for this tool.
            termios.tcflush(self._number, termios.TCIFLUSH)

    def _put_back(self, before: list[Any]) -> None:
        import termios  # noqa: PLC0415 (not on Windows)

        if self._number is not None and _in_foreground(self._number):
            termios.tcflush(self._number, termios.TCIFLUSH)
            termios.tcsetattr(self._number, termios.TCSANOW, before)


def _in_foreground(number: int) -> bool:
    """Whether the terminal is this process's now; one without job control is."""
    try:
        return os.tcgetpgrp(number) == os.getpgrp()
    except OSError:
        return True
