"""The page's server: who is let in, and that no browser holds up the loop that flies."""

import asyncio
import http.client
import json
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import aiohttp
import pytest

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.web.guests import refusal
from echowing.web.live import MOST_EVENTS, LivePage
from echowing.web.options import PageAddress
from echowing.web.server import ASSETS, MOST_BROWSERS, SILENT, PageServer

from .flights import many, moment

DEADLINE_S = 30.0
ANYWHERE, HERE = "0.0.0.0", "127.0.0.1"


@pytest.fixture
def page() -> Iterator[LivePage]:
    made = LivePage(PageAddress(HERE, 0), "follow")
    yield made
    made.close()


def asked(page: LivePage, path: str, method: str = "GET", **headers: str) -> tuple[int, Any, str]:
    line = http.client.HTTPConnection(HERE, page.port, timeout=DEADLINE_S)
    line.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        line.putheader(name, value)
    line.endheaders()
    answer = line.getresponse()
    body = answer.read().decode()
    line.close()
    return answer.status, answer.headers, body


# ---- who is let in ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("served_on", "host", "origin", "let_in"),
    [
        (HERE, "127.0.0.1:8017", None, True),
        (HERE, "localhost:8017", "http://localhost:8017", True),
        (HERE, "LOCALHOST:8017", "http://localhost:8017", True),
        (HERE, "[::1]:8017", None, True),
        (HERE, "evil.example:8017", None, False),  # resolves to 127.0.0.1: DNS rebinding
        (HERE, "127.0.0.1.evil.example", None, False),
        (HERE, "192.168.1.10:8017", None, False),  # nobody who is served can have come by it
        (HERE, "", None, False),
        (HERE, None, None, False),
        (HERE, "[:::", None, False),
        (HERE, "127.0.0.1:8017; script-src *", None, False),
        (HERE, "evil.example@127.0.0.1", None, False),
        (HERE, "127.0.0.1:8017", "http://evil.example", False),
        (HERE, "127.0.0.1:8017", "http://127.0.0.1:9000", False),  # another tool's page
        (HERE, "127.0.0.1:8017", "https://127.0.0.1:8017", False),
        (HERE, "127.0.0.1:8017", "null", False),
        (ANYWHERE, "192.168.1.10:8017", "http://192.168.1.10:8017", True),
        (ANYWHERE, f"{socket.gethostname()}:8017", None, True),
        (ANYWHERE, "evil.example:8017", None, False),
        (ANYWHERE, "evil.example:8017", "http://evil.example:8017", False),
    ],
)
def test_who_is_let_in(served_on: str, host: str | None, origin: str | None, let_in: bool) -> None:
    assert (refusal(served_on, host, origin) is None) is let_in


@pytest.mark.parametrize("path", [*ASSETS, "/live", "/nowhere"])
def test_a_foreign_host_or_origin_gets_nothing(page: LivePage, path: str) -> None:
    own = f"127.0.0.1:{page.port}"
    for headers in (
        {"Host": f"evil.example:{page.port}"},
        {"Host": own, "Origin": "http://evil.example"},
    ):
        status, _, body = asked(page, path, **headers)
        assert status == 403
        assert body.startswith("Refused: ")


def test_all_of_the_page_comes_from_here(page: LivePage) -> None:
    for path in ASSETS:
        status, headers, body = asked(page, path)
        assert status == 200
        assert "http" not in body  # no other server is named
        policy = headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'")
        assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_nothing_can_be_asked_of_it(page: LivePage, method: str) -> None:
    assert asked(page, "/", method)[0] == 405


def test_a_taken_port_is_said(page: LivePage) -> None:
    with pytest.raises(
        EchowingError, match=r"127.0.0.1 cannot listen there: .*for example --web 8018"
    ):
        LivePage(PageAddress(HERE, page.port), "follow")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--web-address", "0.0.0.0"], "--web-address needs --web"),
        (["--web", "70000"], "--web 70000: give a port"),
        (["--web", "--web-address", "field"], "--web-address field: give an address"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_flies(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = ["follow", "--leader", "udpin:1", "--follower", "udpin:2", "--no-log"]
    assert main([*ends, *arguments]) == 2
    assert words in capsys.readouterr().err


# ---- what browsers get ------------------------------------------------------------------------


def watched(page: LivePage, watch: Any) -> None:
    """Run `watch(browser)` with a WebSocket of its own."""

    async def run() -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{page.url}live", max_msg_size=0) as browser,
        ):
            await asyncio.wait_for(watch(browser), DEADLINE_S)

    asyncio.run(run())


async def next_of(browser: Any, kind: str) -> dict[str, Any]:
    while True:
        message = json.loads(await browser.receive_str())
        if message["kind"] == kind:
            return dict(message)


def test_who_comes_late_is_shown_the_last_minute_and_what_was_said(page: LivePage) -> None:
    async def early(browser: Any) -> None:
        for tenth in range(20):
            page.show(moment(tenth / 10.0))
            assert (await next_of(browser, "frame"))["t"] == tenth / 10.0

    page.event(0.5, "follower 2: in Guided, following")
    watched(page, early)

    async def late(browser: Any) -> None:
        hello = await next_of(browser, "hello")
        assert [one["t"] for one in hello["past"]] == [0.0, 0.5, 1.0, 1.5]
        told = await next_of(browser, "events")
        assert told["events"] == [[0.5, "follower 2: in Guided, following"]]
        assert (await next_of(browser, "frame"))["t"] == 1.9

    watched(page, late)


def test_events_come_once_and_are_bounded(page: LivePage) -> None:
    for number in range(MOST_EVENTS + 10):
        page.event(float(number), "said")

    async def watch(browser: Any) -> None:
        told = await next_of(browser, "events")
        assert [one[0] for one in told["events"]] == [float(n) for n in range(10, MOST_EVENTS + 10)]
        page.event(999.0, "more")
        assert (await next_of(browser, "events"))["events"] == [[999.0, "more"]]

    watched(page, watch)


class DeadBrowser:
    """A WebSocket whose other end takes nothing."""

    def __init__(self, port: int) -> None:
        self.line = socket.socket()
        self.line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.line.connect((HERE, port))
        self.line.sendall(
            f"GET /live HTTP/1.1\r\nHost: {HERE}:{port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        assert self.line.recv(12) == b"HTTP/1.1 101"


def test_a_browser_that_reads_nothing_holds_up_nobody(page: LivePage) -> None:
    """Fifty vehicles, to a browser that reads and one that does not; the caller never waits."""
    frames, fifty = 120, many(0.0)
    dead = DeadBrowser(page.port)
    longest_s = 0.0

    async def watch(browser: Any) -> None:
        nonlocal longest_s
        for number in range(frames):
            one = replace(fifty, time_s=float(number))
            begun_s = time.thread_time()
            page.show(one)
            longest_s = max(longest_s, time.thread_time() - begun_s)
            frame = await next_of(browser, "frame")
            assert frame["t"] == number
            assert len(frame["followers"]) == 50

    watched(page, watch)
    # What the caller does is to leave the moment: its own work, not the wait for the page's.
    assert longest_s < 0.02
    dead.line.setblocking(False)
    waited = b""
    try:
        while data := dead.line.recv(1 << 20):
            waited += data
    except BlockingIOError:
        pass
    # 120 frames are 2.5 MB: for the dead one no more is kept than buffers hold.
    assert 0 < len(waited) < 1_000_000
    dead.line.close()


def test_the_end_does_not_wait_for_a_dead_browser(page: LivePage) -> None:
    dead, fifty = DeadBrowser(page.port), many(0.0)

    async def watch(browser: Any) -> None:
        for number in range(60):
            page.show(replace(fifty, time_s=float(number)))
            await next_of(browser, "frame")

    watched(page, watch)
    assert page.close()
    dead.line.close()


class FaultyFeed:
    """Fails with every browser."""

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        pass

    async def attend(self, browser: Any) -> None:
        raise ValueError("a fault of ours")


def test_a_fault_with_one_browser_is_nothing_for_the_terminal(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A traceback on stderr would tear the operator's live table."""
    server = PageServer(PageAddress(HERE, 0), FaultyFeed())
    for _ in range(2):  # and the next browser is served as before
        dead = DeadBrowser(server.address.port)
        while dead.line.recv(4096):
            pass
        dead.line.close()
    assert server.close()
    assert server.error is None
    # All goes to a log of ours that leads nowhere (pytest listens at every one).
    assert {record.name for record in caplog.records} == {SILENT.name}
    assert not SILENT.propagate


def test_too_many_browsers_are_sent_away(page: LivePage) -> None:
    port = page.port
    taken = [DeadBrowser(port) for _ in range(MOST_BROWSERS)]
    line = http.client.HTTPConnection(HERE, port, timeout=DEADLINE_S)
    line.request("GET", "/live")
    assert line.getresponse().status == 503
    for one in taken:
        one.line.close()


def test_a_fault_of_the_page_is_said_once_and_flying_goes_on(page: LivePage) -> None:
    broken: Any = object()
    page.show(broken)
    until_s = time.monotonic() + DEADLINE_S
    while (lost := page.lost()) is None and time.monotonic() < until_s:
        time.sleep(0.01)
    assert lost is not None
    assert "flying goes on" in lost
    assert page.lost() is None
    page.show(moment())  # and it is still asked to
