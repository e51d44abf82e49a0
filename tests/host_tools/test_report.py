"""The report and the picture: whole, self-contained, and true to the flights."""

import base64
import gzip
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from echowing.analysis import plots
from echowing.analysis.animation import FRAME_S, SPEED_UP, write_animation_svg
from echowing.analysis.flight import Flight, Floats
from echowing.analysis.metrics import metrics
from echowing.analysis.picture import write_formation_svg
from echowing.analysis.report import flight_label, write_report
from echowing.analysis.tables import Result
from echowing.errors import EchowingError

COUNT = 600


def flight(name: str, gap_m: float = 4.0, seed: int = 1) -> Flight:
    """A minute northwards, the follower `gap_m` behind, its sonar blind in the last half."""
    time_s: Floats = np.arange(COUNT, dtype=float) * 0.1
    leader = np.column_stack([2.0 * time_s, np.zeros(COUNT), np.full(COUNT, -10.0)])
    velocity = np.tile([2.0, 0.0, 0.0], (COUNT, 1))
    return Flight(
        name=name,
        wanted_separation_m=3.0,
        time_s=time_s,
        leader_ned_m=leader,
        leader_velocity_mps=velocity,
        follower_ned_m=leader - np.array([gap_m, 0.0, 0.0]),
        follower_velocity_mps=velocity,
        follower_yaw_rad=np.zeros(COUNT),
        slot_ned_m=leader - np.array([3.0, 0.0, 0.0]),
        sonar_m=np.where(time_s < 30.0, gap_m, np.nan),
        speed_command_mps=np.full(COUNT, 2.5),
        pan_us=np.full(COUNT, 1500.0),
        tilt_us=np.full(COUNT, 1480.0),
        law="banded",
        seed=seed,
    )


class Page(HTMLParser):
    """The addresses, anchors and plots of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.plots: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if key in ("src", "href"):
                self.addresses.append(value or "")
            elif key == "id":
                self.ids.append(value or "")
            elif key == "data-figure":
                self.plots.append(value or "")


FLIGHTS = [flight("gray", 4.6), flight("echowing", 3.1), flight("</script><b>", 3.5)]


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, FLIGHTS, notes=["A wall & a note."])
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def figures(text: str) -> dict[str, Any]:
    found = re.search(r"const FIGURES = (.*);\n", text)
    assert found is not None
    told: dict[str, Any] = json.loads(found.group(1))
    return told


def test_nothing_is_loaded_from_elsewhere(text: str) -> None:
    page = Page(text)
    assert page.addresses
    assert all(address.startswith("#") for address in page.addresses)


def test_the_contents_lead_to_sections_that_exist(text: str) -> None:
    page = Page(text)
    assert {address[1:] for address in page.addresses} == set(page.ids)
    assert {"results", "compared", "flight-1", "flight-2", "flight-3"} == set(page.ids)


def test_plotly_is_in_it_once_and_packed(text: str) -> None:
    packed = re.findall(r"data-plot-code>([A-Za-z0-9+/=]+)</script>", text)
    assert len(packed) == 1
    assert re.search(rb"plotly\.js v\d", gzip.decompress(base64.b64decode(packed[0])))
    # Unpacked it would be 4.8 MB.
    assert len(text) < 2_500_000


def test_names_cannot_break_the_page(text: str) -> None:
    assert "</script><b>" not in text
    assert "A wall &amp; a note." in text


def test_every_flight_has_its_six_plots_and_every_plot_its_data(
    text: str, figures: dict[str, Any]
) -> None:
    kinds = ("tracks", "matching", "error", "sonar", "speed", "gimbal")
    wanted = {f"{number}-{kind}" for number in (1, 2, 3) for kind in kinds}
    assert wanted | {"compare-1", "compare-2"} == set(figures) == set(Page(text).plots)


def test_plotly_accepts_every_figure(figures: dict[str, Any]) -> None:
    from plotly.graph_objects import Figure  # noqa: PLC0415 (slow to import)

    for figure in figures.values():
        drawn = Figure(figure)  # raises on an unknown key or value
        assert all(len(trace.x) == len(trace.y) for trace in drawn.data)


def test_maps_are_north_up_with_equal_axes() -> None:
    figure = plots.tracks(flight("north"))
    assert figure["layout"]["yaxis"]["scaleanchor"] == "x"
    leader = figure["data"][0]
    assert leader["y"][-1] == pytest.approx(2.0 * 59.9, abs=plots.MAP_STEP_M)
    assert set(leader["x"]) == {0.0}


def test_distances_stand_between_positions_of_the_same_time() -> None:
    figure = plots.matching_times(flight("gap", 4.6))
    leader, follower = figure["data"][1:3]
    assert leader["customdata"] == follower["customdata"] == [0, 9.5, 19, 28.5, 38, 47.5, 57]
    assert {label.strip() for label in figure["data"][3]["text"]} == {"4.6"}
    assert figure["data"][3]["y"][1] == pytest.approx(19.0 - 2.3)
    assert set(figure["data"][3]["textposition"]) == {"middle right"}


def test_no_label_covers_the_data_or_the_toolbar(text: str) -> None:
    """The wanted separation stands right of the plot, a distance a line above a lying pair."""
    wanted = plots.sonar(flight("half"))["layout"]
    (label,) = wanted["annotations"]
    assert (label["xref"], label["xanchor"], label["text"]) == ("paper", "left", "wanted<br>3 m")
    assert label["x"] > 1.0
    assert wanted["margin"]["r"] >= 60
    north = flight("east")
    east = replace(
        north,
        leader_ned_m=north.leader_ned_m[:, [1, 0, 2]],
        follower_ned_m=north.follower_ned_m[:, [1, 0, 2]],
    )
    distances = plots.matching_times(east)["data"][3]
    assert set(distances["textposition"]) == {"top center"}
    assert all(one.endswith("<br> ") for one in distances["text"])
    assert text.count("<figcaption></figcaption><div") == text.count("data-figure=")


def test_sonar_shows_readings_and_where_nothing_was_seen() -> None:
    _, seen, blind = plots.sonar(flight("half"))["data"]
    assert max(seen["x"]) < 30.0 <= min(blind["x"])
    assert set(seen["y"]) == {4.0}
    assert set(blind["y"]) == {7.65}


def test_the_mean_of_the_error_is_drawn_and_named() -> None:
    figure = plots.separation_error([flight("far", 4.6)], ["far"], "Error")
    line, mean = figure["data"]
    assert set(line["y"]) == {1.6} == set(mean["y"])
    assert "+1.60 m" in mean["name"]


def test_thinning_keeps_extremes_and_gaps() -> None:
    values = np.sin(np.arange(50_000) / 300.0)
    values[31_234], values[40_000] = 9.0, np.nan
    kept = plots.thinned(values, most=1000)
    assert len(kept) < 1600
    assert 31_234 in kept and 40_000 in kept
    assert np.nanmin(values[kept]) == np.nanmin(values)


def test_unknown_values_are_gaps_not_numbers() -> None:
    unknown = replace(flight("dark"), pan_us=np.full(COUNT, np.nan))
    assert set(plots.gimbal(unknown)["data"][0]["y"]) == {None}


def test_what_was_not_recorded_gets_no_empty_plot(tmp_path: Path) -> None:
    unknown = np.full(COUNT, np.nan)
    write_report(tmp_path / "r.html", [replace(FLIGHTS[0], pan_us=unknown, tilt_us=unknown)])
    drawn = Page((tmp_path / "r.html").read_text(encoding="utf-8")).plots
    assert drawn == ["1-tracks", "1-matching", "1-error", "1-sonar", "1-speed"]


def test_a_lap_and_the_answer_come_first_and_the_theses_tables_behind_a_fold(
    tmp_path: Path,
) -> None:
    near, far = metrics(FLIGHTS[1]), metrics(FLIGHTS[0])
    results = [Result("gray", far, law="none"), Result("echowing", near, law="hold")]
    lap = FLIGHTS[1], (0.0, 30.0)
    write_report(tmp_path / "r.html", FLIGHTS, results, pictured=lap)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")

    places = [
        text.index(part)
        for part in (
            "Echowing keeps it best.",
            "<polyline",
            "Separation, m (mean",
            "<details><summary>",
            "Error reduced against GPS alone",
            "</details>",
        )
    ]
    assert places == sorted(places)


def test_flights_that_are_compared_are_called_as_in_the_readme(tmp_path: Path) -> None:
    alone, ours = replace(flight("gray"), law="none"), replace(flight("echowing"), law="hold")
    write_report(tmp_path / "r.html", [alone, ours])
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Separation error: GPS alone and Echowing" in text


def test_labels_tell_flights_apart() -> None:
    assert flight_label(flight("echowing", seed=7)) == "echowing, banded law, seed 7"


def test_a_flight_from_logs_shows_its_warnings(tmp_path: Path) -> None:
    warned = replace(flight("logs"), source="logs", warnings=("no GPS time in it",))
    write_report(tmp_path / "r.html", [warned])
    assert "no GPS time in it" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_report_needs_flights_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="no flights"):
        write_report(tmp_path / "r.html", [])
    with pytest.raises(EchowingError, match="cannot be written"):
        write_report(tmp_path / "missing" / "r.html", FLIGHTS)


def circles(path: Path) -> list[tuple[float, float]]:
    tree = ElementTree.parse(path)
    return [
        (float(item.attrib["cx"]), float(item.attrib["cy"]))
        for item in tree.iter("{http://www.w3.org/2000/svg}circle")
    ]


def test_the_picture_holds_pairs_at_the_right_distance(tmp_path: Path) -> None:
    path = tmp_path / "f.svg"
    write_formation_svg(path, flight("<gap>", 4.6), span_s=(0.0, 30.0))
    text = path.read_text(encoding="utf-8")
    assert text.count(">4.6</text>") == 4  # at 0, 9.5, 19 and 28.5 s
    (ax, ay), (bx, by) = circles(path)[:2]
    bar = re.search(r'x1="48\.0" y1="[\d.]+" x2="([\d.]+)"', text)
    assert bar is not None
    pixels_per_metre = (float(bar.group(1)) - 48.0) / 10.0
    assert np.hypot(ax - bx, ay - by) == pytest.approx(4.6 * pixels_per_metre, abs=0.2)


def test_a_picture_longer_north_than_east_lies_down_unmirrored(tmp_path: Path) -> None:
    """North to the left and east up: a quarter turn of the map."""
    north = flight("north")
    beside = north.leader_ned_m + np.array([-4.0, 2.0, 0.0])
    write_formation_svg(tmp_path / "f.svg", replace(north, follower_ned_m=beside))
    leader, follower = circles(tmp_path / "f.svg")[:2]
    assert leader[0] < follower[0]  # the follower is behind, to the south
    assert leader[1] > follower[1]  # and to the east


def test_a_picture_longer_east_than_north_is_north_up(tmp_path: Path) -> None:
    north = flight("north")
    east = north.leader_ned_m[:, [1, 0, 2]]
    beside = east + np.array([2.0, -4.0, 0.0])
    turned = replace(north, leader_ned_m=east, follower_ned_m=beside)
    write_formation_svg(tmp_path / "f.svg", turned)
    leader, follower = circles(tmp_path / "f.svg")[:2]
    assert leader[0] > follower[0]
    assert leader[1] > follower[1]


def test_a_picture_of_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="no sample"):
        write_formation_svg(tmp_path / "f.svg", flight("x"), span_s=(900.0, 901.0))


def moves(path: Path, parent: str, attribute: str) -> list[list[tuple[float, ...]]]:
    """What each animation of `attribute` in elements called `parent` goes through."""
    tree = ElementTree.parse(path)
    name = "{http://www.w3.org/2000/svg}"
    return [
        [tuple(map(float, one.split(","))) for one in move.attrib["values"].split(";")]
        for element in tree.iter(name + parent)
        for move in element
        if move.attrib.get("attributeName") == attribute
    ]


def test_the_animation_moves_both_as_they_flew_and_shows_when_the_sonar_was_blind(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.svg"
    write_animation_svg(path, flight("<gap>", 4.6), (20.0, 40.0), "<gap>")
    leader, follower = moves(path, "circle", "transform")
    assert len(leader) == len(follower) == round(20.0 / FRAME_S) + 1
    pixels = 2.0 * FRAME_S / 4.6  # in a frame, of the gap between the two
    for (ax, ay), (bx, by), (cx, cy) in zip(leader, follower, leader[1:], strict=False):
        gap = np.hypot(ax - bx, ay - by)
        assert np.hypot(cx - ax, cy - ay) == pytest.approx(pixels * gap, abs=0.2)
    (opacities,) = moves(path, "path", "fill-opacity")
    # Blind from 30 s on, shown for half a second more.
    assert [one for (one,) in opacities] == [0.35] * 21 + [0.08] * 20
    text = path.read_text(encoding="utf-8")
    assert f'dur="{20.0 / SPEED_UP:g}s"' in text
    assert "&lt;gap&gt;" in text
    assert "script" not in text


def test_the_same_flight_gives_the_same_animation(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        write_animation_svg(tmp_path / name, flight("x"), (0.0, 30.0), "x")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    with pytest.raises(EchowingError, match="no two samples"):
        write_animation_svg(tmp_path / "c.svg", flight("x"), (900.0, 901.0), "x")
