"""Opens the page for a verb with `--web`."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from echowing.web.options import page_address

if TYPE_CHECKING:
    from echowing.web.live import LivePage


@contextmanager
def page_of(args: argparse.Namespace, source: str) -> "Iterator[LivePage | None]":
    """The live page while a verb runs; None without `--web`."""
    address = page_address(args)
    if address is None:
        yield None
        return
    from echowing.web.live import LivePage  # noqa: PLC0415 (aiohttp takes a while to import)

    page = LivePage(address, source)
    try:
        yield page
    finally:
        page.close()
