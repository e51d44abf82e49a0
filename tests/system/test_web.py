"""The live page in a real browser: what is drawn is what was flown, and nobody else reads it."""

import csv
import math
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser
from tests.host_tools.flights import FOLLOWER, LEADER, many, moment, row, track

from echowing.flight.health import Cut, Health
from echowing.geo import GlobalPosition, ned_between
from echowing.sonar_file import shipped_sonar
from echowing.tool.log import FollowLog
from echowing.tool.moment import Moment
from echowing.web.live import LivePage
from echowing.web.options import PageAddress
from echowing.web.recording import open_recording
from echowing.web.replay import ReplayFeed
from echowing.web.server import PageServer

from .browser import FOREIGN_NAME, PHONE, Sight, chromium
from .field import World, is_followed

pytestmark = pytest.mark.seconds(25)

HERE = "127.0.0.1"
FRAME = "window.echowing.model.frame"
# A moment as it is drawn: the frame, where its vehicles are on the canvas, and what the card says.
SAMPLE = """() => {
  const {model, drawn} = window.echowing;
  if (!model.frame || drawn.t !== model.frame.t || !drawn.top[2]) return null;
  const card = name => document.querySelector(`[data-id="2"] [data-field=${name}]`).textContent;
  const dense = window.devicePixelRatio, [x, y] = drawn.top[2].px;
  const ink = document.getElementById("top").getContext("2d")
    .getImageData(Math.round(x * dense), Math.round(y * dense), 1, 1).data;
  return {frame: model.frame, drawn, ink: [...ink].slice(0, 3), separation: card("separation"),
          mode: card("mode"), state: card("state")};
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as one:
        yield one


@pytest.fixture
def live() -> Iterator[LivePage]:
    page = LivePage(PageAddress(HERE, 0), "follow")
    yield page
    page.close()


def free_port() -> int:
    with socket.create_server((HERE, 0)) as probe:
        return int(probe.getsockname()[1])


# ---- a flight ---------------------------------------------------------------------------------


def test_what_is_drawn_is_what_was_flown_and_it_comes_back_after_a_restart(
    world: World, browser: Browser, tmp_path: Path
) -> None:
    port = free_port()
    web = ("--web", str(port))
    tool = world.follow(*web, "--log", str(tmp_path))
    tool.event(f"page: http://{HERE}:{port}/")
    sight = Sight(browser)
    sight.open(f"http://{HERE}:{port}/")
    tool.row(is_followed)
    # The page may be a few frames behind what the tool has told.
    ready = f"{FRAME}.followers[0].state.startsWith('following') && {FRAME}.followers[0].slot"
    sight.until(f"{FRAME} && {ready} !== null")
    samples: dict[float, dict[str, Any]] = {}
    while len(samples) < 10:
        sample = sight.until(f"({SAMPLE})()")
        samples[sample["frame"]["t"]] = sample
    assert "in Guided, following" in sight.text("events")
    assert tool.end(signal.SIGTERM) == 0
    (table,) = tmp_path.glob("*.csv")
    flown = {float(row["time_s"]): row for row in csv.DictReader(table.open(encoding="utf-8"))}
    for time_s, sample in samples.items():
        agrees(sample, flown[time_s])

    run = sight.reads("window.echowing.model.hello.run")
    sight.until("document.body.classList.contains('lost') && !window.echowing.model.connected")
    sight.until("document.getElementById('headline').innerText.startsWith('No connection')")
    assert sight.text("headline") == "No connection to the tool: what you see is old"
    world.follow(*web)
    sight.until(f"window.echowing.model.hello.run !== '{run}' && {FRAME}")
    sight.until(f"{FRAME}.followers[0].state.startsWith('following')")
    sight.until("!document.body.classList.contains('lost')")
    assert sight.errors == []
    assert sight.asked == {f"{HERE}:{port}"}
    sight.close()


# The log has places to 1e-7 degrees (0.0111 m), the page to 1 mm: half of it each, of two places.
ROUNDED_M = 0.0111 + 0.001


def agrees(sample: dict[str, Any], logged: dict[str, str]) -> None:
    """A sample of the page against the row that the tool has logged for the same moment."""
    (follower,) = sample["frame"]["followers"]
    leader = place(logged, "leader_")
    own, slot = place(logged, ""), place(logged, "slot_", float(logged["leader_alt_m"]))
    # Its report is carried on over its age, to the moment for which the leader is drawn.
    age_s = float(logged["age_s"])
    moved_m = [float(logged[name]) * age_s for name in ("north_mps", "east_mps")]
    there_m = [a + b for a, b in zip(ned_between(leader, own)[:2], moved_m, strict=True)]
    top, metres = sample["drawn"]["top"], sample["drawn"]["metresPerPixel"]
    drawn_m = on_ground(top["1"]["px"], top["2"]["px"], metres)
    assert drawn_m == pytest.approx(there_m, abs=ROUNDED_M)
    slot_m = on_ground(top["1"]["px"], sample["drawn"]["slots"]["2"]["px"], metres)
    assert slot_m == pytest.approx(ned_between(leader, slot)[:2], abs=ROUNDED_M)
    assert sample["separation"] == f"{float(logged['separation_m']):.2f} m"
    assert (sample["mode"], sample["state"]) == (logged["mode"], logged["state"])
    assert follower["sonar"]["range"] == pytest.approx(number(logged["sonar_m"]), abs=0.006)
    assert follower["limit"] == pytest.approx(number(logged["command_mps"]), abs=0.006)
    assert sample["ink"] == [0x1D, 0x4E, 0xD8]  # the first follower's colour is there


def place(logged: dict[str, str], who: str, alt_m: float | None = None) -> GlobalPosition:
    alt = float(logged[f"{who}alt_m"]) if alt_m is None else alt_m
    return GlobalPosition(float(logged[f"{who}lat_deg"]), float(logged[f"{who}lon_deg"]), alt)


def on_ground(from_px: list[float], to_px: list[float], metres_per_pixel: float) -> list[float]:
    """North and east: up and right on the page."""
    right, down = (b - a for a, b in zip(from_px, to_px, strict=True))
    return [-down * metres_per_pixel, right * metres_per_pixel]


def number(cell: str) -> float | None:
    return float(cell) if cell else None


# ---- what is wrong ----------------------------------------------------------------------------


def test_what_is_wrong_is_big_and_plain_on_a_phone(live: LivePage, browser: Browser) -> None:
    sight = Sight(browser, PHONE, dense=2)
    sight.open(live.url)
    sight.until("document.getElementById('headline').innerText === 'Waiting for the vehicles'")
    # Read at once, and shown again until it is: three seconds later it is old.
    good = sight.until(_HEAD.format("good"), lambda: live.show(moment(1.0)))
    assert good["headline"] == "1 of 1 following"
    stale: dict[str, Any] = {"leader_age_s": 2.4, "state": "holding: leader is stale"}
    act = sight.until(_HEAD.format("act"), lambda: live.show(moment(2.0, **stale)))
    assert act["headline"] == "Leader: no report for 2.4 s"
    assert act["alarms"] == "Follower 2: holding: leader is stale"
    assert act["size"] >= 1.25 * good["size"]
    # All of it fits the width of a phone.
    assert sight.reads("document.documentElement.scrollWidth") <= PHONE[0]
    # And when the tool says nothing any more, though it is connected.
    sight.until("document.getElementById('status').className === 'lost'")
    assert sight.text("headline") == "No data from the tool: what you see is old"
    assert sight.errors == []
    sight.close()


_HEAD = """document.getElementById('status').className === '{}' && {{
  headline: document.getElementById('headline').innerText,
  alarms: document.getElementById('alarms').innerText,
  size: parseFloat(getComputedStyle(document.getElementById('headline')).fontSize),
}}"""


def test_health_is_marked(live: LivePage, browser: Browser) -> None:
    health = Health(
        ranges=((2, LEADER), (3, LEADER)), cuts=(Cut(LEADER, ((2,), (3,))),), alone=(4,), lost=(4,)
    )
    rows = [row(one, time_s=1.0) for one in (2, 3, 4)]
    tracks = [track(), track(0.0, 3.0), track(-20.0)]
    sight = Sight(browser)
    sight.open(live.url)
    live.show(Moment(1.0, rows, tracks, health))
    sight.until(f"{FRAME} && document.querySelectorAll('article').length === 4")
    assert sight.field(LEADER, "note") == "Its loss splits: 2 | 3"
    assert sight.field(4, "note") == "Sees nobody"
    assert sight.text("headline").startswith("Follower 4 sees nobody any more")
    sight.close()


def test_words_of_a_vehicle_are_words(live: LivePage, browser: Browser) -> None:
    """What a vehicle says may look like a page."""
    evil = "<img src=x onerror=alert(1)>"
    sight = Sight(browser)
    sight.open(live.url)
    live.event(0.5, evil)
    live.show(moment(1.0, state=evil))
    sight.until(f"{FRAME} && document.querySelector('article.follower')")
    assert sight.field(FOLLOWER, "state") == evil
    assert evil in sight.text("events")
    assert sight.reads("document.images.length") == 0
    sight.close()


def test_what_a_sonar_has_heard_stands_on_its_card(live: LivePage, browser: Browser) -> None:
    sight = Sight(browser)
    sight.open(live.url)
    live.show(moment(1.0, heard_percent=74.2, scatter_m=0.018, wrong_percent=1.6))
    sight.until(f"{FRAME} && document.querySelector('article.follower')")
    assert sight.field(FOLLOWER, "sonar").endswith("hears 74 % ± 2 cm 2 % wrong")
    sight.close()


def test_the_table_before_engaging_stands_as_it_was_said(live: LivePage, browser: Browser) -> None:
    lines = [
        "before engaging  clock   applet",
        "leader 1         0.02 s  -",
        "follower 2       0.02 s  off!",
    ]
    sight = Sight(browser, PHONE)
    sight.open(live.url)
    live.event(1.0, "leader is system 1")
    for line in lines:
        live.event(1.5, line)
    live.event(2.5, lines[-1])
    live.event(2.5, "follower 2: its applet is off")
    live.show(moment(3.0))
    sight.until("document.querySelectorAll('#events li').length === 4")
    tables = sight.reads("[...document.querySelectorAll('#events pre')].map(one => one.innerText)")
    assert tables == [lines[-1], "\n".join(lines)]  # the newest event is the first one
    assert sight.reads("document.documentElement.scrollWidth") <= PHONE[0]
    sight.close()


@pytest.mark.parametrize(("source", "words"), [("follow", "by GPS"), ("sim", "in truth")])
def test_the_curve_says_what_it_is(source: str, words: str, browser: Browser) -> None:
    page = LivePage(PageAddress(HERE, 0), source)
    sight = Sight(browser)
    sight.open(page.url)
    page.show(moment(1.0))
    sight.until("document.getElementById('separation-legend').innerText !== ''")
    assert sight.text("separation-legend").startswith(f"line: {words};")
    sight.close()
    page.close()


def test_fifty_vehicles_are_all_drawn(live: LivePage, browser: Browser) -> None:
    sight = Sight(browser)
    sight.open(live.url)
    live.show(many(1.0))
    sight.until("Object.keys(window.echowing.drawn.top).length === 51")
    box = sight.reads("document.getElementById('top').getBoundingClientRect().toJSON()")
    places = sight.reads("Object.values(window.echowing.drawn.top).map(one => one.px)")
    assert all(0 <= x <= box["width"] and 0 <= y <= box["height"] for x, y in places)
    assert sight.reads("document.querySelectorAll('article').length") == 51
    assert sight.errors == []
    sight.close()


# ---- who may read it --------------------------------------------------------------------------


def test_a_foreign_site_gets_neither_page_nor_stream(live: LivePage, browser: Browser) -> None:
    port = live.port
    sight = Sight(browser)
    answer = sight.page.goto(f"http://{FOREIGN_NAME}:{port}/")
    assert answer is not None
    assert answer.status == 403
    # Another server's page on this machine, as any site could be: its script may not listen in.
    other = LivePage(PageAddress(HERE, 0), "follow")
    context = browser.new_context(bypass_csp=True)
    foreign = context.new_page()
    foreign.goto(other.url)
    listens = """url => new Promise(done => {
      const line = new WebSocket(url);
      line.onopen = () => done("open");
      line.onerror = () => done("refused");
    })"""
    assert foreign.evaluate(listens, f"ws://{HERE}:{port}/live") == "refused"
    assert foreign.evaluate(listens, other.url.replace("http", "ws") + "live") == "open"
    context.close()
    other.close()
    sight.close()


# ---- replay -----------------------------------------------------------------------------------

REPLAYED_S = 100


@pytest.fixture
def replayed(tmp_path: Path) -> Iterator[str]:
    """A logged flight in which the separation grows by 1 cm a second."""
    log = FollowLog(tmp_path, 1_000_000.0, print)
    for tenth in range(10 * REPLAYED_S):
        time_s = tenth / 10.0
        one = row(time_s=time_s, separation_m=3.0 + time_s / 100.0)
        log.rows(1_000_000.0 + time_s, [one], [track(leader_north_m=2.0 * time_s)])
    log.event(1_000_030.0, "follower 2: gives way to follower 3")
    log.close()
    server = PageServer(
        PageAddress(HERE, 0), ReplayFeed(open_recording([tmp_path], shipped_sonar()))
    )
    yield server.address.url
    server.close()


def test_a_replay_has_a_time_line(replayed: str, browser: Browser) -> None:
    sight = Sight(browser)
    sight.open(replayed)
    sight.until(f"{FRAME} && {FRAME}.t > 0.5")
    assert sight.text("events") == ""
    page = sight.page
    page.select_option("#speed", "100")
    sight.until(f"{FRAME}.t === {REPLAYED_S - 0.1}")  # to the end, and there it stays
    assert "30.0" in sight.text("events")
    page.click("#play")
    sight.until(f"{FRAME}.replay.paused")
    page.fill("#line", "50")
    sight.until("window.echowing.drawn.t === 50")
    assert sight.field(FOLLOWER, "separation") == "3.50 m"
    # The minute before is there as if it had been watched.
    assert sight.reads("window.echowing.model.past.length") >= 100
    assert sight.reads(f"Math.hypot(...{FRAME}.leader.at)") == pytest.approx(100.0, abs=0.1)
    page.click("#play")
    page.select_option("#speed", "0.5")
    sight.until(f"{FRAME}.t > 50")
    page.click("#events li")  # what was said at 30 s
    sight.until(f"{FRAME}.t >= 30 && {FRAME}.t < 45")
    assert not math.isnan(sight.reads(f"{FRAME}.t"))
    assert sight.errors == []
    sight.close()
