"""Flights of many rows and seeds on all cores."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

Row = TypeVar("Row")
Result = TypeVar("Result")


def flown(
    fly: Callable[[Row, int], Result],
    rows: Sequence[Row],
    seeds: range,
    advance: Callable[[], None],
    jobs: int | None = None,
) -> list[list[Result]]:
    """`fly(row, seed)` for each row and seed, by row; `advance` is called after each flight."""
    with ProcessPoolExecutor(jobs or os.cpu_count()) as pool:
        futures = [[pool.submit(fly, row, seed) for seed in seeds] for row in rows]
        for _ in as_completed(one for of_row in futures for one in of_row):
            advance()
    return [[one.result() for one in of_row] for of_row in futures]
