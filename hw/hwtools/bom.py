"""Bill of materials: parts, wire from the wiring, prints from the STL files, and their mass."""

from collections import Counter
from typing import Any

from hwtools import mount, servos, wiring
from hwtools.facts import HW, HardwareError, load
from hwtools.rig import read_stl

SOURCE = HW / "parts.toml"
REPORT = HW / "BOM.md"
GRAMS_PER_POUND = 453.592


def parts(table: str = "part") -> list[dict[str, Any]]:
    """Return the parts of a table of the file; a servo's mass comes from `servos.toml`."""
    return [_weighed(part) for part in load(SOURCE)[table]]


def _weighed(part: dict[str, Any]) -> dict[str, Any]:
    if "servo" not in part:
        return part
    mass = next(row for row in servos.Servo().rows if row["what"] == "mass")
    return part | {"mass_g": mass["value"], "mass_source": mass["source"]}


def parts_for(board: str) -> list[dict[str, Any]]:
    """Return the parts of a build with this board, in the file's order."""
    return [part for part in parts() if board in part.get("boards", [board])]


def wire_lengths_m(board: str) -> dict[str, float]:
    """Return the metres of wire that fly, by gauge: the USB cable stays on the bench."""
    lengths: Counter[str] = Counter()
    cables = [*wiring.draw(board, wiring.OVERVIEW).cables.values()]
    for cable in cables:
        if cable.ignore_in_bom or cable.gauge is None:
            continue
        wires = cable.wirecount if cable.category == "bundle" else 1  # a lead is weighed whole
        lengths[f"{cable.gauge} {cable.gauge_unit}"] += wires * cable.length
    return dict(sorted(lengths.items()))


def print_mass_g(part: str) -> float:
    """Return a printed part's mass were it solid."""
    volume_mm3 = read_stl(mount.stl_path(part)).volume
    return float(volume_mm3) / 1e3 * float(load(SOURCE)["print_density_g_cm3"])


def masses_g(board: str) -> dict[str, float]:
    """Return the mass of a build by group: parts, wire, prints."""
    weigh = load(SOURCE)["wire_g_m"]
    lengths = wire_lengths_m(board)
    if unknown := [gauge for gauge in lengths if gauge not in weigh]:
        raise HardwareError(f"{SOURCE}: [wire_g_m] has no mass for {', '.join(unknown)}")
    return {
        "parts": sum(part["quantity"] * part["mass_g"] for part in parts_for(board)),
        "wire": sum(length * weigh[gauge] for gauge, length in lengths.items()),
        "prints": sum(print_mass_g(part) for part in mount.PARTS),
    }


def price_usd(board: str) -> float:
    """Return what the parts of a build cost, without wire and filament."""
    return sum(float(part["quantity"] * part["price_usd"]) for part in parts_for(board))


def payload_limit_g() -> float:
    """Return the X8's payload limit."""
    return float(load(SOURCE)["payload_limit_lb"]) * GRAMS_PER_POUND


def report_text() -> str:
    """Return BOM.md."""
    table = load(SOURCE)
    lines = [
        "# Bill of materials",
        "",
        "Written by `make hw` from `parts.toml`, the wiring and the STL files; a test keeps it",
        "current. What each drawing needs, to the last resistor, stands beside it",
        "(`pictures/wiring/BOARD/*.bom.tsv`).",
        "",
        "## Mass and price",
        "",
        "| board | parts, g | wire, g | prints, g | total, g | of the X8's payload | parts, US$ |",
        "|---|---|---|---|---|---|---|",
        *(_mass_row(board) for board in wiring.BOARDS),
        "",
        f"Payload limit {payload_limit_g():.0f} g ({table['payload_source']}).",
        f"Prints count as solid ({table['print_density_source']}).",
        f"Wire: {table['wire_g_m']['wire_source']}.",
        f"Prices: {table['price_source']}",
        "The sum has the parts of one follower in it, without wire and filament.",
        "",
        "## Follower",
        "",
        *_part_table(parts()),
        "",
        "## Printed parts",
        "",
        "| part | file | mass if solid, g |",
        "|---|---|---|",
        *(
            f"| {part} | `mount/stl/{part}.stl` | {print_mass_g(part):.0f} |"
            for part in mount.PARTS
        ),
        "",
        "## Wire",
        "",
        "| gauge | " + " | ".join(f"{board}, m" for board in wiring.BOARDS) + " |",
        "|---|" + "---|" * len(wiring.BOARDS),
        *_wire_rows(),
        "",
        "## Leader",
        "",
        *_part_table(parts("leader")),
        "",
        "## In the field box",
        "",
        *_part_table(parts("spare")),
        "",
    ]
    return "\n".join(lines)


def _mass_row(board: str) -> str:
    mass = masses_g(board)
    total = sum(mass.values())
    share = 100 * total / payload_limit_g()
    groups = " | ".join(f"{mass[group]:.0f}" for group in ("parts", "wire", "prints"))
    return f"| {board} | {groups} | {total:.0f} | {share:.0f} % | {price_usd(board):.0f} |"


def _part_table(listed: list[dict[str, Any]]) -> list[str]:
    return [
        "| part | for | number | each, g | mass from | each, US$ | boards | alternatives |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {part['name']} | {part['purpose']} | {part['quantity']} | {part['mass_g']:g} "
            f"| {part.get('mass_source', 'estimate')} | {part['price_usd']:g} "
            f"| {', '.join(part.get('boards', ['all']))} "
            f"| {part['alternatives']} |"
            for part in listed
        ),
    ]


def _wire_rows() -> list[str]:
    by_board = {board: wire_lengths_m(board) for board in wiring.BOARDS}
    gauges = sorted({gauge for lengths in by_board.values() for gauge in lengths})
    return [
        f"| {gauge} | "
        + " | ".join(f"{by_board[b].get(gauge, 0.0):.2f}" for b in wiring.BOARDS)
        + " |"
        for gauge in gauges
    ]
