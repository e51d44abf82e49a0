"""Chromium through the DevTools protocol, and the live page in it."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

DEADLINE_S = 60.0
DESK, PHONE = (1280, 900), (390, 844)
# A name that the browser resolves to this machine, as an attacker's name server would have it.
FOREIGN_NAME = "evil.example"
ARGUMENTS = ["--no-sandbox", f"--host-resolver-rules=MAP {FOREIGN_NAME} 127.0.0.1"]


@contextmanager
def chromium() -> Iterator[Browser]:
    """The system's Chromium, or the one that playwright has installed (host_tools/setup.sh)."""
    with sync_playwright() as driver:
        found = shutil.which("chromium") or shutil.which("google-chrome")
        browser = driver.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield browser
        browser.close()


class Sight:
    """A page that is open in a browser. Its errors and what it asks of other servers are kept."""

    def __init__(self, browser: Browser, size: tuple[int, int] = DESK, dense: int = 1) -> None:
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, device_scale_factor=dense
        )
        self.page: Page = context.new_page()
        self.errors: list[str] = []
        self.asked: set[str] = set()
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.asked.add(request.url.split("/")[2]))

    def open(self, url: str) -> None:
        self.page.goto(url)
        self.until("Boolean(window.echowing)")

    def reads(self, expression: str) -> Any:
        """The value of an expression in the page."""
        return self.page.evaluate(expression)

    def until(self, expression: str, meanwhile: Callable[[], None] = lambda: None) -> Any:
        """Wait until an expression is true, doing something again and again; returns its value."""
        until_s = time.monotonic() + DEADLINE_S
        while True:
            meanwhile()
            if value := self.reads(expression):
                return value
            if time.monotonic() > until_s:
                pytest.fail(f"never so: {expression}; errors: {self.errors}; {self.text('status')}")
            time.sleep(0.05)

    def text(self, element_id: str) -> str:
        return str(self.reads(f"document.getElementById('{element_id}').innerText"))

    def field(self, system_id: int, name: str) -> str:
        """What a vehicle's card says."""
        card = f'[data-id="{system_id}"] [data-field={name}]'
        return str(self.reads(f"document.querySelector('{card}').textContent"))

    def close(self) -> None:
        self.page.context.close()
