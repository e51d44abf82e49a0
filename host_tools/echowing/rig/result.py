"""What a bench test found: checks and a verdict; JSON document, page, lines in the terminal."""

import html
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from echowing.analysis.page import box, page, table, write_page
from echowing.analysis.plots import Figure
from echowing.analysis.tables import Grid, terminal_grid
from echowing.errors import EchowingError

if TYPE_CHECKING:
    from rich.console import Console

PASS, FAIL, INCOMPLETE = "PASS", "FAIL", "INCOMPLETE"
EXIT_CODES = {PASS: 0, FAIL: 1, INCOMPLETE: 2}

_STYLES = {PASS: "bold green", FAIL: "bold red", INCOMPLETE: "bold yellow"}


@dataclass(frozen=True)
class Check:
    """One thing that had to hold. limit: what was asked for, and where that comes from."""

    what: str
    found: str
    limit: str
    passed: bool

    @property
    def verdict(self) -> str:
        """PASS or FAIL."""
        return PASS if self.passed else FAIL


@dataclass
class Result:
    """A finished bench test, or one that was broken off.

    procedure: its verb. measured: what goes into the JSON document as it is. grids, figures (a
    caption and a plotly figure) and notes: what is shown; page_grids: too long for the terminal;
    terminal_grids: where the page has a figure. incomplete: why it was broken off, or what
    is missing.
    """

    procedure: str
    title: str
    checks: Sequence[Check] = ()
    measured: Mapping[str, Any] = field(default_factory=dict)
    grids: Sequence[Grid] = ()
    page_grids: Sequence[Grid] = ()
    terminal_grids: Sequence[Grid] = ()
    figures: Mapping[str, Figure] = field(default_factory=dict)
    notes: Sequence[str] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    incomplete: str | None = None

    @property
    def verdict(self) -> str:
        """PASS only when everything was measured and every check holds."""
        if self.incomplete is not None:
            return INCOMPLETE
        return PASS if self.checks and all(check.passed for check in self.checks) else FAIL

    def document(self) -> dict[str, Any]:
        """The JSON document; what is not known is null."""
        return {
            "procedure": self.procedure,
            "verdict": self.verdict,
            "incomplete": self.incomplete,
            **self.facts,
            "checks": [
                {"what": c.what, "found": c.found, "limit": c.limit, "verdict": c.verdict}
                for c in self.checks
            ],
            "measured": _plain(self.measured),
            "notes": list(self.notes),
        }

    def html(self) -> str:
        """The page."""
        facts = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in self.facts.items())
        why = f'<p class="warning">{html.escape(self.incomplete)}</p>' if self.incomplete else ""
        boxes = "".join(box(name, _is_map(figure)) for name, figure in self.figures.items())
        cards = "".join(
            f'<div class="card">{table(grid)}</div>' for grid in (*self.grids, *self.page_grids)
        )
        body = [
            f"<header><h1>{html.escape(self.title)}</h1>",
            f'<p class="facts">{html.escape(facts)}</p>{_badge(self.verdict)}{why}</header>',
            f'<h2>Checks</h2><div class="card">{_checks_table(self.checks)}</div>',
            f'<div class="plots" style="margin-top: 16px">{boxes}</div>' if boxes else "",
            f'<div class="cards">{cards}</div>',
            "".join(f"<p>{html.escape(note)}</p>" for note in self.notes),
        ]
        return page(self.title, "\n".join(body), self.figures)

    def show(self, console: "Console") -> None:
        """Tables, checks and verdict, for the terminal."""
        for grid in (*self.grids, *self.terminal_grids):
            console.print(terminal_grid(grid))
        for note in self.notes:
            console.print(note, style="dim", highlight=False, markup=False)
        for check in self.checks:
            style = _STYLES[check.verdict]
            console.print(f"[{style}]{check.verdict}[/]  ", end="")
            line = f"{check.what}: {check.found} ({check.limit})"
            console.print(line, markup=False, highlight=False)
        why = f": {self.incomplete}" if self.incomplete else ""
        console.print(f"[{_STYLES[self.verdict]}]{self.procedure}: {self.verdict}[/]", end="")
        console.print(why, markup=False, highlight=False)


def write_result(result: Result, folder: Path) -> tuple[Path, Path]:
    """Write `<procedure>.json` and `<procedure>.html` into the folder, which is made if need be.

    Raises EchowingError when that cannot be done.
    """
    document, shown = (folder / f"{result.procedure}.{kind}" for kind in ("json", "html"))
    prepare_folder(folder)
    try:
        text = json.dumps(result.document(), indent=1, allow_nan=False)
        document.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"result {document}: cannot be written: {error.strerror}") from error
    write_page(shown, result.html(), "result")
    return document, shown


def prepare_folder(folder: Path, option: str = "--out") -> None:
    """Make the folder of results, and see that it takes files: before hours of measuring."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise EchowingError(f"{option} {folder}: cannot be written: {error.strerror}") from error


def _checks_table(checks: Sequence[Check]) -> str:
    rows = "".join(
        f'<tr><td class="{c.verdict.lower()}">{c.verdict}</td>'
        f'<td class="words">{html.escape(c.what)}</td><td class="words">{html.escape(c.found)}</td>'
        f'<td class="words">{html.escape(c.limit)}</td></tr>'
        for c in checks
    )
    head = "".join(f'<th class="words">{text}</th>' for text in ("what", "found", "asked for"))
    return f"<table><tr><th></th>{head}</tr>{rows}</table>"


def _is_map(figure: Figure) -> bool:
    """Whether both axes have one scale: such a figure is taller."""
    return "scaleanchor" in figure["layout"]["yaxis"]


def _badge(verdict: str) -> str:
    return f'<span class="verdict {verdict.lower()}">{verdict}</span>'


def _plain(value: Any) -> Any:
    """The same with null for what JSON cannot say."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
