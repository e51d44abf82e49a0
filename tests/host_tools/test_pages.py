"""Figures and lists on the pages for people, against the code they come from."""

import re
from pathlib import Path

import pytest

from echowing.docs.shapes import picture
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import LINK_SIGMA_M, WASH_M, receivers_demand_m, sonars_demand_m
from echowing.flight.leader_speed import MOST_LEADER_MPS
from echowing.paths import repository_root

ROOT = repository_root()
FILES = [
    path
    for folder in (".", "firmware", "host_tools", "hw", "lua", "tests/sitl")
    for path in (ROOT / folder).glob("*.md")
]
PAGES = {path.name: path.read_text(encoding="utf-8") for path in reversed(FILES)}
# The target of a link or a picture on a page, but no address.
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s]+)\)")


def test_when_to_abort_stands_on_one_page_and_the_other_leads_there() -> None:
    listed = [name for name, text in PAGES.items() if "nose turns away" in text]
    assert listed == ["FLYING.md"]
    assert "**Abort** by [the list](../host_tools/FLYING.md#abort)" in PAGES["echowing.md"]
    assert "## Abort" in PAGES["FLYING.md"]


@pytest.mark.parametrize(
    ("page", "words", "figure"),
    [
        ("FLYING.md", "at least {} m apart", f"{receivers_demand_m(LEAST_M):.2f}"),
        (
            "GUIDANCE.md",
            "nearer than {} m, as receivers demand",
            f"{receivers_demand_m(LEAST_M):.2f}",
        ),
        ("GUIDANCE.md", "{} m is what one sonar leaves unsure", f"{LINK_SIGMA_M:g}"),
        ("GUIDANCE.md", "{} m for two sonars", f"{sonars_demand_m(LEAST_M, 2):.1f}"),
        (
            "FLYING.md",
            "both sonars reach the leader, {} m is enough",
            f"{sonars_demand_m(LEAST_M, 2):.1f}",
        ),
        ("GUIDANCE.md", "less than {} m beside it", f"{WASH_M:g}"),
        ("GUIDANCE.md", "A leader flies at up to {} m/s", f"{MOST_LEADER_MPS:g}"),
        ("README.md", "leader up to {} m/s", f"{MOST_LEADER_MPS:g}"),
    ],
)
def test_what_follow_demands_is_on_the_page(page: str, words: str, figure: str) -> None:
    assert words.format(figure) in PAGES[page]


# An abbreviated commit: seven digits or more, letters and figures among them.
COMMIT = re.compile(r"\b(?=[0-9a-f]*[0-9])(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}\b")
# What a board prints of itself, on the page that shows its view.
PRINTED = {"RIG.md": ["1e8003ee"]}


def test_only_results_name_commits() -> None:
    """A page says when something was measured; only who compares figures asks with what code."""
    named = {
        str(page.relative_to(ROOT)): [
            one
            for one in COMMIT.findall(page.read_text(encoding="utf-8"))
            if one not in PRINTED.get(page.name, [])
        ]
        for page in FILES
        if page.name != "RESULTS.md"
    }
    assert {page: commits for page, commits in named.items() if commits} == {}
    assert COMMIT.findall(PAGES["RESULTS.md"])


def test_the_picture_of_the_shapes_is_current() -> None:
    committed = ROOT / "host_tools" / "pictures" / "shapes.svg"
    assert committed.read_text(encoding="utf-8") == picture(), "run `make pages`"


def test_readme_is_read_in_one_sitting() -> None:
    assert len(PAGES["README.md"].split()) <= 1500


def test_links_between_pages_lead_somewhere() -> None:
    """To a file that is there, and to a heading that the page has."""
    lost = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in FILES
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if not _leads_somewhere(page, target)
    ]
    assert lost == []


def _leads_somewhere(page: Path, target: str) -> bool:
    file, _, heading = target.partition("#")
    there = (page.parent / file).resolve() if file else page
    if not there.exists():
        return False
    return not heading or heading in _headings(there)


def _headings(page: Path) -> set[str]:
    """Of a page, as GitHub names them in links."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in titles}
