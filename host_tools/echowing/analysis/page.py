"""One HTML page with everything in it, readable without a network: flights, bench tests."""

import base64
import gzip
import html
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from echowing.analysis.plots import Figure
from echowing.analysis.tables import Grid, Row
from echowing.errors import EchowingError
from echowing.extras import lacks_plots

STYLE = """
:root { color-scheme: light; --ink: #253046; --quiet: #667085; --rule: #e0e4eb; --accent: #1f6feb; }
* { box-sizing: border-box; }
body { margin: 0; font: 15px/1.55 system-ui, sans-serif; color: var(--ink); background: #f4f6f9; }
main { max-width: 1360px; margin: 0 auto; padding: 24px 20px 64px; }
header h1 { margin: 0 0 4px; font-size: 28px; letter-spacing: -0.01em; }
h2 { margin: 40px 0 4px; font-size: 20px; scroll-margin-top: 12px; }
p, li { max-width: 110ch; }
.facts, .notes { color: var(--quiet); margin: 0 0 12px; }
.card .notes { margin-top: 12px; }
.notes { font-size: 13px; padding-left: 18px; }
.warning { color: #9a3412; }
nav ol { columns: 3 260px; margin: 8px 0 0; padding-left: 22px; }
nav a { color: var(--accent); text-decoration: none; }
nav a:hover { text-decoration: underline; }
.card { background: #fff; border: 1px solid var(--rule); border-radius: 10px; padding: 16px 18px;
  margin-top: 16px; overflow-x: auto; }
.plots { display: grid; gap: 16px;
  grid-template-columns: repeat(auto-fit, minmax(min(540px, 100%), 1fr)); }
.plot { overflow: hidden; min-height: 372px; min-width: 0; }
.plot.map { min-height: 522px; }
figure { background: #fff; border: 1px solid var(--rule); border-radius: 10px; margin: 0;
  min-width: 0; }
figcaption { font-size: 15px; font-weight: 600; padding: 10px 16px 0; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: 6px; white-space: nowrap; }
.cards { display: flex; flex-wrap: wrap; gap: 16px; align-items: flex-start; margin-top: 16px; }
.cards .card { margin-top: 0; max-width: 100%; }
th, td { text-align: right; padding: 4px 12px; white-space: nowrap; }
th { color: var(--quiet); font-weight: 600; border-bottom: 1px solid var(--rule); }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
tr.printed td { color: var(--quiet); font-style: italic; border-bottom: 1px solid var(--rule); }
tr.printed td:first-child { padding-left: 20px; }
table + table { margin-top: 22px; }
.verdict { display: inline-block; padding: 2px 14px; border-radius: 999px; font-weight: 700;
  color: #fff; background: var(--quiet); }
.verdict.pass { background: #1a7f5a; }
.verdict.fail { background: #b42318; }
td.pass { color: #1a7f5a; font-weight: 700; }
td.fail { color: #b42318; font-weight: 700; }
td.words, th.words { text-align: left; white-space: normal; max-width: 60ch; }
"""

# Figures are drawn when they come near the screen: a report of many flights opens at once.
SCRIPT = """
const options = {responsive: true, displaylogo: false,
  modeBarButtonsToRemove: ['lasso2d', 'select2d', 'autoScale2d']};
const draw = box => {
  const figure = FIGURES[box.dataset.figure];
  Plotly.newPlot(box, figure.data, figure.layout, options);
};
const boxes = document.querySelectorAll('.plot');
// The title stands over the plot, where the toolbar cannot cover it.
boxes.forEach(box => {
  const layout = FIGURES[box.dataset.figure].layout;
  box.previousElementSibling.textContent = layout.title.text;
  delete layout.title;
});
const watcher = new IntersectionObserver(entries => {
  for (const entry of entries) if (entry.isIntersecting) {
    watcher.unobserve(entry.target);
    draw(entry.target);
  }
}, {rootMargin: '800px'});
const unpacked = async () => {
  const packed = atob(document.querySelector('[data-plot-code]').textContent);
  const bytes = Uint8Array.from(packed, letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Response(stream).text();
};
const start = code => {
  const tag = document.createElement('script');
  tag.textContent = code;
  document.head.append(tag);
  boxes.forEach(box => watcher.observe(box));
  addEventListener('beforeprint', () => boxes.forEach(box => { if (!box.data) draw(box); }));
};
unpacked().then(start).catch(error => boxes.forEach(box => {
  box.textContent = `The plots need a browser of 2023 or newer (${error}).`;
}));
"""


def page(title: str, body: str, figures: Mapping[str, Figure]) -> str:
    """The page: `body` is HTML that holds a `box` for each figure, by name.

    Without the extra [plots] a line at the top takes their place.
    """
    lacks = lacks_plots()
    note = _without_plots(lacks) if lacks else ""
    plots = "" if lacks else _plots(figures)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style>"
        f"</head>\n<body><main>\n{note}{body}\n</main>\n{plots}</body></html>\n"
    )


def _without_plots(why: str) -> str:
    return (
        "<style>figure:has([data-figure]) { display: none; }</style>\n"
        f'<p class="warning">{html.escape(why)}</p>\n'
    )


def _plots(figures: Mapping[str, Figure]) -> str:
    data = json.dumps(figures, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    return (
        f'<script type="text/plain" data-plot-code>{_plot_code()}</script>\n'
        f"<script>const FIGURES = {data};\n{SCRIPT}</script>"
    )


@cache
def _plot_code() -> str:
    """Plotly, packed to two fifths of its 4.8 MB: what a report weighs is mostly this."""
    from plotly.offline import get_plotlyjs  # noqa: PLC0415 (large; only for reports)

    packed = gzip.compress(get_plotlyjs().encode(), mtime=0)  # the same bytes each time
    return base64.b64encode(packed).decode()


def box(name: str, is_map: bool = False) -> str:
    """Where the figure of that name is drawn, under its title."""
    kind = "plot map" if is_map else "plot"
    return (
        f'<figure><figcaption></figcaption><div class="{kind}" data-figure="{name}"></div></figure>'
    )


def table(grid: Grid) -> str:
    """A table with its caption."""
    head = "".join(f"<th>{html.escape(text)}</th>" for text in grid.head)
    rows = "".join(map(_row, grid.rows))
    caption = html.escape(grid.title)
    return f"<table><caption>{caption}</caption><tr>{head}</tr>{rows}</table>"


def _row(row: Row) -> str:
    cells = "".join(f"<td>{html.escape(cell.strip())}</td>" for cell in row.cells)
    return f'<tr class="printed">{cells}</tr>' if row.printed else f"<tr>{cells}</tr>"


def told(path: Path) -> str:
    """A written page, for the terminal: where it is, and whether it lacks its plots."""
    return "; ".join(filter(None, (str(path), lacks_plots())))


def write_page(path: Path, text: str, what: str) -> None:
    """Write it; EchowingError names `what` could not be written, and why."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"{what} {path}: cannot be written: {error.strerror}") from error
