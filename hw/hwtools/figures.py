"""The numbers of `budget.toml`, by name."""

from typing import Any

from hwtools.facts import HW, load

SOURCE = HW / "budget.toml"


class Figures:
    """The numbers by name."""

    def __init__(self, table: dict[str, Any]) -> None:
        self._table = table

    def __getattr__(self, name: str) -> float:
        return float(self._table[name]["value"])

    def board(self, board: str) -> dict[str, Any]:
        """Return a board's own figures."""
        return dict(self._table["board"][board])


def figures() -> Figures:
    """Read `budget.toml`."""
    return Figures(load(SOURCE))
