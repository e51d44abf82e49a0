"""The page's server: aiohttp in a thread of its own, with its own event loop."""

import asyncio
import logging
import socket
import threading
from collections.abc import Awaitable, Callable
from importlib.resources import files
from typing import Protocol

from aiohttp import WSCloseCode, web

from echowing.errors import EchowingError
from echowing.web.guests import refusal
from echowing.web.options import PageAddress

ASSETS = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
}
# The page loads nothing from elsewhere, and no other page may show it in a frame.
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src data:; connect-src 'self' {socket}; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
# Most browsers at once: the operator's, the pilots' phones, and some to spare.
MOST_BROWSERS = 16
# A browser that has not answered a ping for this long is gone.
HEARTBEAT_S = 10.0
# What a browser may send at once, bytes: a replay's speed and place.
MOST_HEARD = 1024
# Kernel buffer per connection, bytes: small, so that a slow browser shows the present.
SEND_BUFFER = 65_536
START_S, END_S = 10.0, 2.0
# Invalid requests of browsers are not shown on the operator's terminal.
SILENT = logging.getLogger("echowing.page")
SILENT.addHandler(logging.NullHandler())
SILENT.propagate = False

Socket = web.WebSocketResponse
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Feed(Protocol):
    """The data for the browsers."""

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """Called when the server's loop runs."""

    async def attend(self, browser: Socket) -> None:
        """Serve one browser until it has gone."""


class PageServer:
    """Serves the page and a feed until it is closed.

    error: what has ended it, other than `close`. Raises EchowingError if it cannot listen on the
    address.
    """

    def __init__(self, address: PageAddress, feed: Feed) -> None:
        self._feed = feed
        self._socket = _bound(address)
        self.address = PageAddress(address.host, self._socket.getsockname()[1])
        self.error: Exception | None = None
        self._browsers: set[Socket] = set()
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        self._started.wait(START_S)

    def close(self) -> bool:
        """End it; False: it is stuck, and is left behind."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join(END_S)
        return not self._thread.is_alive()

    # ---- in its thread --------------------------------------------------------------------------

    def _run(self) -> None:
        self._loop.set_exception_handler(lambda loop, context: SILENT.error("%s", context))
        try:
            self._loop.run_until_complete(self._serve())
        except Exception as error:
            self.error = error
        finally:
            self._started.set()
            self._loop.close()

    async def _serve(self) -> None:
        app = web.Application(middlewares=[self._guarded])
        app.router.add_get("/live", self._live)
        for path, (name, kind) in ASSETS.items():
            app.router.add_get(path, self._asset(name, kind))
        app.on_shutdown.append(self._send_away)
        runner = web.AppRunner(app, access_log=None, logger=SILENT, shutdown_timeout=END_S / 4.0)
        await runner.setup()
        try:
            await web.SockSite(runner, self._socket).start()
            self._feed.begin(self._loop)
            self._started.set()
            await self._ended.wait()
        finally:
            await runner.cleanup()

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        host = request.headers.get("Host")
        reason = refusal(self.address.host, host, request.headers.get("Origin"))
        if reason is not None:
            return web.Response(status=403, text=f"Refused: {reason}.\n")
        return await handler(request)

    @staticmethod
    def _asset(name: str, kind: str) -> Handler:
        body = (files("echowing.web") / "page" / name).read_bytes()

        async def serve(request: web.Request) -> web.StreamResponse:
            headers = {
                key: value.replace("{socket}", f"ws://{request.headers['Host']}")
                for key, value in HEADERS.items()
            }
            return web.Response(body=body, content_type=kind, charset="utf-8", headers=headers)

        return serve

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if len(self._browsers) >= MOST_BROWSERS:
            return web.Response(
                status=503, text=f"{MOST_BROWSERS} browsers are connected already.\n"
            )
        browser = Socket(heartbeat=HEARTBEAT_S, max_msg_size=MOST_HEARD, compress=False)
        await browser.prepare(request)
        self._browsers.add(browser)
        try:
            await self._feed.attend(browser)
        except ConnectionError:
            pass  # it has gone
        finally:
            self._browsers.discard(browser)
        return browser

    async def _send_away(self, app: web.Application) -> None:
        """Close the connection; a browser that reads nothing does not notice it."""
        code, words = WSCloseCode.GOING_AWAY, b"the tool ends"
        goodbyes = [
            asyncio.ensure_future(browser.close(code=code, message=words))
            for browser in self._browsers
        ]
        if not goodbyes:
            return
        _, stuck = await asyncio.wait(goodbyes, timeout=END_S / 4.0)
        for goodbye in stuck:
            goodbye.cancel()


def _bound(address: PageAddress) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        # A restarted tool reuses its port; on Windows this would take another tool's port.
        if hasattr(socket, "SO_REUSEPORT"):
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        bound.bind((address.host, address.port))
        bound.listen()
    except OSError as error:
        bound.close()
        raise EchowingError(
            f"--web {address.port}: {address.host} cannot listen there: {error.strerror}; give "
            "another port, for example --web 8018"
        ) from error
    bound.setblocking(False)
    return bound


async def until_gone(browser: Socket, serve: Awaitable[None]) -> None:
    """Serve a browser while what it sends is read and left aside; its pongs are in there."""

    async def ignore() -> None:
        async for _ in browser:
            pass

    await either(serve, ignore())


async def either(*jobs: Awaitable[None]) -> None:
    """Do some jobs until one of them is over, or fails."""
    tasks = [asyncio.ensure_future(job) for job in jobs]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
