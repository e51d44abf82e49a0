"""What all tests share: the order in which they begin."""

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files come first: begun last, each would keep one worker alone at the end."""
    items.sort(key=_seconds, reverse=True)


def _seconds(item: pytest.Item) -> float:
    """How long its file takes, as marked; unmarked files are short, and keep their order."""
    marker = item.get_closest_marker("seconds")
    return float(marker.args[0]) if marker else 0.0
