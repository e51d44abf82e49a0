"""What all tests share: the order in which they begin, who runs them, and Ctrl-C."""

import signal

import pytest

# A shell starts what it puts in the background with Ctrl-C ignored, and its children inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Folders whose files look at the same solids, which OpenSCAD makes in a quarter of a minute.
OF_ONE_WORKER = {"hw"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A file is one worker's, or a folder. The longest come first.

    Begun last, each would keep one worker alone at the end. pytest-xdist reads the groups in this
    hook, too: after it, each test would go to any worker, and two would build in one folder.
    """
    items.sort(key=_seconds, reverse=True)
    for item in items:
        folder = item.path.parent.name
        group = folder if folder in OF_ONE_WORKER else str(item.path)
        item.add_marker(pytest.mark.xdist_group(group))


def _seconds(item: pytest.Item) -> float:
    """How long its file takes, as marked; unmarked files are short, and keep their order."""
    marker = item.get_closest_marker("seconds")
    return float(marker.args[0]) if marker else 0.0
