"""Figures and lists on the pages for people, against the code they come from."""

import pytest

from echowing.flight.formation import receivers_demand_m
from echowing.flight.guard import MIN_SEPARATION_M
from echowing.flight.leader_speed import MOST_LEADER_MPS
from echowing.paths import repository_root

PAGES = {
    path.name: path.read_text(encoding="utf-8")
    for folder in ("", "lua", "host_tools")
    for path in (repository_root() / folder).glob("*.md")
}


def test_when_to_abort_stands_on_one_page_and_the_other_leads_there() -> None:
    listed = [name for name, text in PAGES.items() if "nose turns away" in text]
    assert listed == ["README.md"]
    assert "**Abort** by the list in [README](../README.md#fly-it-for-real)" in PAGES["echowing.md"]
    assert "## Fly it for real" in PAGES["README.md"]


@pytest.mark.parametrize(
    ("words", "figure"),
    [
        ("at least {} m apart", f"{receivers_demand_m(MIN_SEPARATION_M):.2f}"),
        ("**The leader's speed.** At up to {} m/s", f"{MOST_LEADER_MPS:g}"),
    ],
)
def test_what_follow_demands_is_on_the_page(words: str, figure: str) -> None:
    assert words.format(figure) in PAGES["README.md"]
