"""Errors that are the user's to fix: printed as one clear message, never as a traceback."""

from collections.abc import Iterable


class EchowingError(Exception):
    """Something outside the program is wrong: says what, where and what to do about it."""


def nearest(name: str, names: Iterable[str]) -> str:
    """The end of an error about an unknown name: `; the nearest is NAME`, empty if none is near."""
    import difflib  # noqa: PLC0415 (only for an error)

    found = difflib.get_close_matches(name, list(names), n=1)
    return f"; the nearest is {found[0]}" if found else ""
