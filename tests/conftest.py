"""What all tests share: the order in which they begin, and Ctrl-C."""

import signal

import pytest

# A shell starts what it puts in the background with Ctrl-C ignored, and its children inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files come first: begun last, each would keep one worker alone at the end."""
    items.sort(key=_seconds, reverse=True)


def _seconds(item: pytest.Item) -> float:
    """How long its file takes, as marked; unmarked files are short, and keep their order."""
    marker = item.get_closest_marker("seconds")
    return float(marker.args[0]) if marker else 0.0
