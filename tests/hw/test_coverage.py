"""The coverage plot's numbers."""

import math
from pathlib import Path

import pytest

from echowing.analysis.thesis import THESIS_GAIN_PERCENT
from echowing.rig.search import Aim, covered, scan_pulses_us
from hwtools import coverage
from hwtools.facts import scan_aims

# thesis Appendix A, channel 6 and 7 pulses in order
APPENDIX_A = [
    (1330, 1400),
    (1330, 1500),
    (1380, 1500),
    (1400, 1500),
    (1400, 1400),
    (1380, 1400),
    (1330, 1400),
    (1330, 1300),
    (1380, 1300),
    (1400, 1300),
    (1400, 1400),
    (1380, 1400),
]


def cap_sr(half_angle_deg: float) -> float:
    """Solid angle of a cone."""
    return 2 * math.pi * (1 - math.cos(math.radians(half_angle_deg)))


def test_scan_is_read_from_the_firmware() -> None:
    assert scan_pulses_us() == APPENDIX_A


def test_aims_are_degrees_from_straight_ahead() -> None:
    # 10 us a degree about 1380 and 1400
    assert scan_aims()[3] == Aim(2.0, 10.0)
    assert scan_aims()[7] == Aim(-5.0, -10.0)


@pytest.mark.parametrize("half_angle_deg", [10.0, 20.0, 40.0])
def test_one_beam_covers_a_cap(half_angle_deg: float) -> None:
    cover = covered([Aim(0.0, 0.0)], half_angle_deg)
    assert cover.one_sr == pytest.approx(cap_sr(half_angle_deg), rel=2e-3)
    assert cover.gain_percent == pytest.approx(0.0)


def test_beams_apart_add_up_and_beams_together_do_not() -> None:
    apart = covered([Aim(-30.0, 0.0), Aim(30.0, 0.0)], 10.0)
    assert apart.all_sr == pytest.approx(2 * cap_sr(10.0), rel=3e-3)
    together = covered([Aim(5.0, 5.0), Aim(5.0, 5.0)], 10.0)
    assert together.all_sr == pytest.approx(cap_sr(10.0), rel=3e-3)


def test_the_search_adds_less_to_a_wider_beam() -> None:
    gains = [covered(scan_aims(), half).gain_percent for half in (15.0, 20.0, 30.0, 40.0)]
    assert gains == sorted(gains, reverse=True)
    assert gains[-1] > 0.0


def test_plot_prints_the_thesis_figure_beside_ours(tmp_path: Path) -> None:
    path = tmp_path / "coverage.svg"
    coverage.draw(path)
    drawn = path.read_text(encoding="utf-8")
    assert f"thesis: +{THESIS_GAIN_PERCENT:.0f} %" in drawn
    assert "with 50 sq in of foil" in drawn


def test_plot_is_the_same_twice(tmp_path: Path) -> None:
    coverage.draw(tmp_path / "one.svg")
    coverage.draw(tmp_path / "two.svg")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
