"""Everything of a board on one sheet that can be read at the width of a page: a row per wire.

WireViz draws all harnesses side by side; its picture (`all.png`) is for a large print. This sheet
is made from the same wires, cable under cable.
"""

import html
from typing import Any

from wireviz.wv_colors import get_color_hex  # type: ignore[import-untyped]

from hwtools import wiring

WIDTH, EDGE = 900.0, 24.0
ROW, HEAD, GAP, LINE = 24.0, 30.0, 14.0, 18.0
# Where the wire is drawn; the ends are named left and right of it.
LEFT, RIGHT = 355.0, 545.0
INK, QUIET, RULE = "#253046", "#667085", "#e0e4eb"


class Sheet:
    """SVG from the top down."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.y = EDGE

    def text(self, x: float, text: str, *, anchor: str = "start", style: str = "") -> None:
        """Text at the present height."""
        self.parts.append(
            f'<text x="{x:g}" y="{self.y:g}" text-anchor="{anchor}"{style}>'
            f"{html.escape(text)}</text>"
        )

    def document(self) -> str:
        """The whole file."""
        height = self.y + EDGE
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {height:g}" '
            f'width="{WIDTH:g}" height="{height:g}" font-family="Arial, sans-serif" '
            f'font-size="14" fill="{INK}">\n<rect width="100%" height="100%" fill="#ffffff"/>\n'
            + "\n".join(self.parts)
            + "\n</svg>\n"
        )


def svg_text(board: str) -> str:
    """Return the sheet of a board."""
    harness = wiring.draw(board, wiring.OVERVIEW)
    sheet = Sheet()
    sheet.y += 16.0
    title = wiring.board_sheet(board)["metadata"]["title"]
    sheet.text(EDGE, f"{title}: every wire", style=' font-size="20" font-weight="bold"')
    sheet.y += GAP
    for cable in harness.cables.values():
        _cable(sheet, cable, harness.connectors)
    _notes(sheet, harness.connectors)
    return sheet.document()


def _cable(sheet: Sheet, cable: Any, connectors: dict[str, Any]) -> None:
    sheet.y += HEAD
    top = sheet.y - 20.0
    sheet.parts.append(
        f'<rect x="{EDGE:g}" y="{top:g}" width="{WIDTH - 2 * EDGE:g}" height="26" fill="{RULE}"/>'
    )
    gauge = f"{cable.gauge} {cable.gauge_unit}" if cable.gauge else ""
    told = (cable.type, gauge, f"{cable.length:g} m" if cable.length else "", cable.notes)
    name = cable.name.removeprefix("W_").replace("_", " ").lower()
    sheet.text(EDGE + 8, name, style=' font-weight="bold"')
    sheet.text(WIDTH - EDGE - 8, ", ".join(filter(None, told)), anchor="end")
    sheet.y += 4.0
    for wire in cable.connections:
        sheet.y += ROW
        _wire(sheet, cable, wire, connectors)
    sheet.y += GAP - 4.0


def _wire(sheet: Sheet, cable: Any, wire: Any, connectors: dict[str, Any]) -> None:
    shield = wire.via_port == "s"
    colour = "shield" if shield else cable.colors[wire.via_port - 1]
    ink = QUIET if shield else get_color_hex(colour)[0]
    y = sheet.y - 5.0
    for width, stroke in ((6, INK), (4, ink)):
        sheet.parts.append(
            f'<line x1="{LEFT:g}" y1="{y:g}" x2="{RIGHT:g}" y2="{y:g}" stroke="{stroke}" '
            f'stroke-width="{width}"/>'
        )
    middle = (LEFT + RIGHT) / 2
    sheet.parts.append(
        f'<rect x="{middle - 26:g}" y="{y - 8:g}" width="52" height="16" rx="3" fill="#ffffff"/>'
    )
    sheet.text(middle, colour, anchor="middle", style=' font-size="13"')
    sheet.text(LEFT - 10, _end(connectors, wire.from_name, wire.from_pin), anchor="end")
    sheet.text(RIGHT + 10, _end(connectors, wire.to_name, wire.to_pin))


def _end(connectors: dict[str, Any], name: str | None, pin: Any) -> str:
    """A connector and its pin: label, and number where it is another."""
    if name is None:
        return "open, insulated"
    connector = connectors[name]
    label = connector.pinlabels[connector.pins.index(pin)] if connector.pinlabels else pin
    number = "" if str(label) == str(pin) else f" ({pin})"
    same = [other for other in connectors.values() if other.type == connector.type]
    # A board's USB socket is not its pin headers.
    which = f", {connector.subtype}" if len(same) > 1 and "USB" in str(connector.subtype) else ""
    return f"{connector.type}{which}: {label}{number}"


def _notes(sheet: Sheet, connectors: dict[str, Any]) -> None:
    """What stands at the connectors: parts, and what to mind."""
    sheet.y += HEAD
    sheet.text(EDGE, "At the connectors", style=' font-size="17" font-weight="bold"')
    for connector in connectors.values():
        lines = str(connector.notes or "").splitlines()
        if not lines:
            continue
        sheet.y += LINE + 8.0
        sheet.text(EDGE, connector.type, style=' font-weight="bold"')
        for line in lines:
            sheet.y += LINE
            sheet.text(EDGE + 16, line)
