"""Pictures of the live page for WEB.md: `python -m echowing.web.picture DIR`.

Two simulated vehicles follow a third in real time, led by the real tool, and Chromium shows its
page: `DIR/web.png` on a desk, `DIR/web-phone.png` on a phone. `make setup-test` installs what it
needs.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from echowing.tool.picture import LONGEST_S, PORT, SETTLED_S
from echowing.web.options import LOOPBACK

PAGE_PORT = 8019
FORMATION = "[[slots]]\nradius_m = 3.0\n[[slots]]\nradius_m = 3.0\nangle_deg = 75.0\n"
WORLD = (
    *("echowing", "--set", "leader.speed_mps=1.5"),
    *("--set", "formation.slots=[{radius_m=3.0},{radius_m=3.0, angle_deg=75.0}]"),
)
# Width, height and pixels per CSS pixel; the phone's picture ends below the first vehicle.
SIZES = {"web.png": (1280, 940, 1), "web-phone.png": (390, 844, 2)}
# So long the tracks grow before the picture, with all in their places.
TRACKS_S = 25.0
IN_PLACE = """() => {
  const frame = window.echowing && window.echowing.model.frame;
  return Boolean(frame) && frame.followers.length === 2
    && frame.followers.every(one => one.state === "following" && Math.abs(one.error) < 0.6);
}"""


def photograph(folder: Path) -> None:
    """Fly, and write the pictures. Raises TimeoutError when the vehicles never were in place."""
    with _flight(folder) as url, sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        pages = []
        for name, (width, height, dense) in SIZES.items():
            context = browser.new_context(
                viewport={"width": width, "height": height}, device_scale_factor=dense
            )
            page = context.new_page()
            page.goto(url)
            pages.append((name, page))
        _settle(pages[0][1])
        for name, page in pages:
            page.screenshot(path=str(folder / name))
        browser.close()


def _settle(page: Page) -> None:
    """Wait until all have been in place for a while, and the tracks are long."""
    started_s = since_s = time.monotonic()
    while time.monotonic() < max(since_s + SETTLED_S, started_s + TRACKS_S):
        if time.monotonic() - started_s > LONGEST_S:
            raise TimeoutError(f"not in place within {LONGEST_S:g} s")
        if not page.evaluate(f"({IN_PLACE})()"):
            since_s = time.monotonic()
        page.wait_for_timeout(100.0)


@contextmanager
def _flight(folder: Path) -> Iterator[str]:
    """The address of the page of a tool that flies."""
    echowing = [sys.executable, "-m", "echowing"]
    with tempfile.TemporaryDirectory() as scratch:
        formation = Path(scratch) / "formation.toml"
        formation.write_text(FORMATION, encoding="utf-8")
        follow = [
            *("follow", "--leader", f"tcp:{LOOPBACK}:{PORT}@1"),
            *("--follower", f"tcp:{LOOPBACK}:{PORT + 10}@2"),
            *("--follower", f"tcp:{LOOPBACK}:{PORT + 20}@3"),
            *("--formation", str(formation), "--engage", "--no-log", "--web", str(PAGE_PORT)),
        ]
        with (
            _started([*echowing, "sim", *WORLD, "--serve", str(PORT)], "system 3"),
            _started([*echowing, *follow], "page: "),
        ):
            yield f"http://{LOOPBACK}:{PAGE_PORT}/"


@contextmanager
def _started(command: list[str], says: str) -> Iterator[None]:
    """A process that has said so much; what it says after that goes nowhere."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if says in line:
                    break
            yield
        finally:
            process.terminate()
            process.stdout.read()


if __name__ == "__main__":
    photograph(Path(sys.argv[1]))
