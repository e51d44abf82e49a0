"""What the terminal can do."""

import os
import sys

# Rich draws nothing on these until the very end (Console.is_dumb_terminal).
_WITHOUT_CURSOR = ("dumb", "unknown")


def draws_live() -> bool:
    """Whether stdout is a terminal on which a picture can be drawn again and again."""
    return sys.stdout.isatty() and os.environ.get("TERM", "").lower() not in _WITHOUT_CURSOR
