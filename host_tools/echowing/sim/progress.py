"""A progress bar for long flights, on the terminal only."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class FlightProgress:
    """Simulated seconds done, over one flight after another."""

    def __init__(self, advance_to: Callable[[float], None] | None = None) -> None:
        self._done_s = 0.0
        self._flying_s = 0.0
        self._advance_to = advance_to

    def __call__(self, t_s: float) -> None:
        """`t_s` seconds of the present flight are flown."""
        self._flying_s = t_s
        if self._advance_to is not None:
            self._advance_to(self._done_s + t_s)

    def next_flight(self) -> None:
        """The present flight is over."""
        self._done_s += self._flying_s
        self._flying_s = 0.0


@contextmanager
def flight_progress(total_s: float, *, quiet: bool = False) -> Iterator[FlightProgress]:
    """A bar over `total_s` simulated seconds; silent where nobody is looking."""
    if quiet or not sys.stderr.isatty():
        yield FlightProgress()
        return
    from rich.console import Console  # noqa: PLC0415 (slow import, seldom needed)
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    columns = (
        TextColumn("flying"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} s simulated"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("flying", total=total_s)
        yield FlightProgress(lambda done_s: bar.update(task, completed=done_s))
