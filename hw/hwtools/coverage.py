"""What the figure-8 search covers: thesis Figure 17, computed."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from echowing.analysis.thesis import TABLE_5, THESIS_GAIN_PERCENT
from echowing.rig import search
from echowing.rig.search import Aim, covered
from hwtools.facts import beam_half_angle_deg, read, scan_aims

CURVE_STEP_DEG = 0.25  # good enough for a line


def inputs_text() -> str:
    """Return what the plot is drawn from: the numbers and this file."""
    numbers = (scan_aims(), beam_half_angle_deg(), TABLE_5)
    return repr(numbers) + read(Path(search.__file__)) + read(Path(__file__))


def draw(path: Path) -> None:
    """Draw the coverage plot as SVG (the same bytes for the same matplotlib)."""
    mpl.rcParams["svg.hashsalt"] = "echowing"  # ids in the SVG, else random
    mpl.rcParams["svg.fonttype"] = "none"  # text stays text
    figure = Figure(figsize=(15, 5.4), layout="constrained")
    view, widths, leader = figure.subplots(1, 3, width_ratios=(1.1, 1.1, 0.8))
    _draw_view(view)
    _draw_widths(widths)
    _draw_leader(leader)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


def _draw_view(axes: Axes) -> None:
    aims, half = scan_aims(), beam_half_angle_deg()
    cover = covered(aims, half)
    for edge in (True, False):  # all edges first: only the outline of the whole stays visible
        for aim in aims:
            look = {"fc": "none", "ec": "#c7741a", "lw": 2} if edge else {"fc": "#fbd08a", "lw": 0}
            axes.add_patch(Circle((aim.right_deg, aim.up_deg), half, **look))
    axes.add_patch(Circle((0, 0), half, fc="#8fce92", ec="#2e9e3f", lw=1.5))
    rights, ups = [aim.right_deg for aim in aims], [aim.up_deg for aim in aims]
    axes.plot(rights, ups, "-", color="#333333", lw=1)
    axes.plot(rights, ups, "*", color="black", ms=8)
    for text, offset, numbers in _numbered(aims):
        axes.annotate(numbers, text, xytext=offset, textcoords="offset points", fontsize=8)
    axes.set(
        aspect="equal",
        xlim=(-30, 30),
        ylim=(-34, 34),
        xlabel="right of straight ahead, degrees",
        ylabel="up, degrees",
        title=f"Search, beam half-angle {half:g}°: +{cover.gain_percent:.0f} % "
        f"(thesis: +{THESIS_GAIN_PERCENT:.0f} %)",
    )
    axes.grid(alpha=0.3)


def _draw_widths(axes: Axes) -> None:
    halves = np.arange(10.0, 46.0, 2.5)
    aims = scan_aims()
    gains = [covered(aims, half, CURVE_STEP_DEG).gain_percent for half in halves]
    axes.plot(halves, gains, color="#c7741a")
    axes.axhline(THESIS_GAIN_PERCENT, ls="--", color="#666666")
    axes.annotate("thesis 3.4.2: 43 %", (11, THESIS_GAIN_PERCENT + 4), fontsize=9)
    here = beam_half_angle_deg()
    axes.plot([here], [covered(aims, here).gain_percent], "o", color="#2e9e3f")
    axes.set(
        ylim=(0, None),
        xlabel="beam half-angle, degrees",
        ylabel="added to the area of one beam, %",
        title="What the search adds, by the beam's width",
    )
    axes.grid(alpha=0.3)


def _draw_leader(axes: Axes) -> None:
    places = np.arange(len(TABLE_5))
    stock = [seen.stock_m for seen in TABLE_5.values()]
    foil = [seen.foil_m for seen in TABLE_5.values()]
    for shift, ranges, label, color in (
        (-0.2, stock, "X8 as it comes", "#9aa5b1"),
        (0.2, foil, "with 50 sq in of foil", "#4a7fb5"),
    ):
        axes.bar_label(axes.bar(places + shift, ranges, 0.38, label=label, color=color), fmt="%.1f")
    axes.set_xticks(places, list(TABLE_5))
    axes.set(ylabel="seen up to, metres", ylim=(0, 6), title="Leader made reflective (Table 5)")
    axes.legend(loc="upper left", fontsize=9)


def _numbered(aims: list[Aim]) -> list[tuple[tuple[float, float], tuple[int, int], str]]:
    """Return a label for each distinct point: where, offset in points, its numbers in order."""
    visits: dict[Aim, list[str]] = {}
    for number, aim in enumerate(aims, start=1):
        visits.setdefault(aim, []).append(str(number))
    return [
        ((aim.right_deg, aim.up_deg), _label_offset(aim), ", ".join(seen))
        for aim, seen in visits.items()
    ]


def _label_offset(aim: Aim) -> tuple[int, int]:
    """Left of the points on the left, under the middle ones, right of those on the right."""
    if aim.right_deg == 0.0:
        return (-8, -14)
    return (7, 4) if aim.right_deg > 0.0 else (-26, 4)
