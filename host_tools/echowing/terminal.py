"""What the terminal can do."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

# Rich draws nothing on these until the very end (Console.is_dumb_terminal).
_WITHOUT_CURSOR = ("dumb", "unknown")


def draws_live() -> bool:
    """Whether stdout is a terminal on which a picture can be drawn again and again."""
    return sys.stdout.isatty() and os.environ.get("TERM", "").lower() not in _WITHOUT_CURSOR


def ring() -> None:
    """Ring the bell of the terminal, where there is one."""
    if sys.stderr.isatty():
        sys.stderr.write("\a")
        sys.stderr.flush()


def run_in_flight(run: Callable[[], int], stuck: Callable[[], bool]) -> int:
    """Run a tool that flies on this process's terminal, which then cannot stop it.

    Where the terminal still takes nothing at the end (`stuck`) the process ends without it.
    Returns the tool's exit code.
    """
    code = 1
    try:
        with flying_terminal():
            code = run()
    finally:
        if stuck():
            os._exit(code)
    return code


@contextmanager
def flying_terminal() -> Iterator[None]:
    """While something flies, no key stops it: neither Ctrl-S (XOFF) nor Ctrl-Z.

    Put back as it was at the end.
    """
    with ExitStack() as stack:
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
    """Take XOFF off a terminal, and have the stack put it back."""
    try:
        import termios  # noqa: PLC0415 (not on Windows)

        number = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except (ImportError, OSError):
        return
    stack.callback(os.close, number)
    before = termios.tcgetattr(number)
    without = list(before)
    without[0] &= ~termios.IXON
    termios.tcsetattr(number, termios.TCSANOW, without)
    stack.callback(termios.tcsetattr, number, termios.TCSANOW, before)
