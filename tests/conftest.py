"""What all tests share: the order in which they begin, Ctrl-C, and how they are collected."""

import gc
import signal

import pytest

# A third of the time of collecting goes into looking for garbage, of which there is none yet.
gc.disable()

# A shell starts what it puts in the background with Ctrl-C ignored, and its children inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files come first: begun last, each would keep one worker alone at the end."""
    items.sort(key=_seconds, reverse=True)


def pytest_collection_finish() -> None:
    """What has been collected stays until the end: it is not looked through again."""
    gc.collect()
    gc.freeze()
    gc.enable()


def _seconds(item: pytest.Item) -> float:
    """How long its file takes, as marked; unmarked files are short, and keep their order."""
    marker = item.get_closest_marker("seconds")
    return float(marker.args[0]) if marker else 0.0
