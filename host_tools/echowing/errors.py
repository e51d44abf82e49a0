"""Errors that are the user's to fix: printed as one clear message, never as a traceback."""


class EchowingError(Exception):
    """Something outside the program is wrong: says what, where and what to do about it."""
