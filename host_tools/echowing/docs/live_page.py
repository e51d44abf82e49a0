"""Pictures of the live page for WEB.md: `python -m echowing.docs.live_page DIR`.

Two simulated vehicles follow a third, and Chromium shows the page with what the ground knows of
them: `DIR/web.png` on a desk, `DIR/web-phone.png` on a phone. `make setup-test` installs what it
needs.
"""

import shutil
import sys
import time
from functools import partial
from pathlib import Path

from playwright.sync_api import Page, sync_playwright
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.health import Cohesion
from echowing.sim.flight import FormationFlight
from echowing.sim.hangar import LEADER_ID
from echowing.sim.scenario import load_scenario
from echowing.tool.moment import Moment, members, places
from echowing.tool.panel import Panel
from echowing.tool.track import track
from echowing.web.live import LivePage
from echowing.web.options import PageAddress

WORLD = (
    "leader.speed_mps=1.5",
    "formation.slots=[{radius_m=3.0},{radius_m=3.0, angle_deg=75.0}]",
    "formation.slot_separation_m=3.5",  # the picture's vehicles are to be seen in one view
    "duration_s=52",  # after the first corner
)
# Width, height and pixels per CSS pixel; the phone's picture ends below the first vehicle.
SIZES = {"web.png": (1280, 960, 1), "web-phone.png": (390, 844, 2)}
SHOWN_EVERY, JUDGED_EVERY = 5, 50  # steps of 20 ms
# So long the page's thread has for a moment, that none is left out of the tracks.
TAKE_S = 0.005
DRAW_MS = 400.0


class GroundOnPage:
    """What the ground knows of a simulated flight, on the page."""

    def __init__(self, flight: FormationFlight, page: LivePage) -> None:
        self._flight, self._page = flight, page
        self._session = flight.ground.session
        self._panel = Panel(flight.ground.links)
        self._sonar = flight.scenario.sonar_belief
        self._cohesion = Cohesion(LEADER_ID, self._sonar)
        self._steps = self._told = 0
        for system_id, link in flight.ground.links.items():
            link.tap = partial(self._heard, mavlink.MAVLink(None, system_id))
        self.last: Moment | None = None

    def _heard(self, mav: mavlink.MAVLink, what: str, t_s: float, frame: bytes) -> None:
        if what == "arrived":
            self._panel.receive(mav.decode(bytearray(frame)), t_s)

    def step(self) -> None:
        """A step of the world is over."""
        self._steps += 1
        if self._steps % SHOWN_EVERY:
            return
        now_s, session = self._flight.t_s, self._session
        tracks = [track(session, one, self._panel, now_s) for one in session.followers.values()]
        moment = Moment(now_s, self._panel.rows(session, now_s), tracks)
        origin = moment.origin
        if origin is not None and self._steps % JUDGED_EVERY == 0:
            vehicles = members(moment, places(moment, origin), self._sonar)
            for text in self._cohesion.update(vehicles, now_s):
                self._page.event(now_s, text)
        for time_s, text in session.events[self._told :]:
            self._page.event(time_s, text)
        self._told = len(session.events)
        self.last = Moment(now_s, moment.rows, tracks, self._cohesion.health)
        self._page.show(self.last)
        time.sleep(TAKE_S)


def photograph(folder: Path) -> None:
    """Fly, and write the pictures."""
    page = LivePage(PageAddress(port=0), "follow")
    flight = FormationFlight(load_scenario("echowing", list(WORLD)), seed=1)
    ground = GroundOnPage(flight, page)
    flight.run(after_step=ground.step)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        for name, (width, height, dense) in SIZES.items():
            context = browser.new_context(
                viewport={"width": width, "height": height}, device_scale_factor=dense
            )
            _shoot(context.new_page(), page, ground, folder / name)
        browser.close()
    page.close()


def _shoot(sight: Page, page: LivePage, ground: GroundOnPage, path: Path) -> None:
    assert ground.last is not None
    sight.goto(page.url)
    while not sight.evaluate("window.echowing.drawn.t > 0"):
        page.show(ground.last)
        sight.wait_for_timeout(DRAW_MS)
    page.show(ground.last)  # or it is said that nothing comes any more
    sight.wait_for_timeout(DRAW_MS)
    sight.screenshot(path=str(path))


if __name__ == "__main__":
    photograph(Path(sys.argv[1]))
