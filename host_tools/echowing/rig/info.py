"""`echowing rig info`: the board, its firmware and its parameters."""

import argparse
from typing import Any

from rich.console import Console
from rich.table import Table

from echowing.rig.board import Board, open_board
from echowing.rig.options import print_json
from echowing.rig.ports import usb_devices
from echowing.rig.search import parameter_defaults

EXAMPLES = """\
examples:
  echowing rig info
  echowing rig info --json | jq .parameters.TRACK_RANGE
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's options."""
    parser.epilog = EXAMPLES


def run(args: argparse.Namespace) -> int:
    """Ask the board and print it."""
    with open_board(args.port, args.baud) as board:
        known = facts(board)
    if args.json:
        print_json(known)
    else:
        show(known, Console())
    return 0


def facts(board: Board) -> dict[str, Any]:
    """The board's own data."""
    version = board.version()
    parameters = board.parameters()
    board.wait_state()
    usb = next((device for device in usb_devices() if device.device == board.name), None)
    return {
        "port": board.name,
        "usb": None if usb is None else f"{usb.description}, USB {usb.usb_id}",
        "system_id": board.system_id,
        "component_id": board.component_id,
        "version": version.firmware,
        "git_hash": version.git_hash,
        "parameters": parameters,
        "state": board.state.state,
        "sonar_fault": board.state.critical,
    }


def show(known: dict[str, Any], console: Console) -> None:
    """The same as text."""
    usb = f", {known['usb']}" if known["usb"] else ""
    console.print(f"port       {known['port']}{usb}", highlight=False)
    console.print(
        f"board      system {known['system_id']}, component {known['component_id']}",
        highlight=False,
    )
    console.print(
        f"firmware   {known['version']} (git {known['git_hash'] or 'unknown'})", highlight=False
    )
    console.print(f"state      {known['state']}\n", highlight=False)
    console.print(parameter_table(known["parameters"]))


def parameter_table(parameters: dict[str, float]) -> Table:
    """Parameters beside their defaults; differences are highlighted."""
    defaults = parameter_defaults()
    table = Table("parameter", "value", "default", box=None, pad_edge=False)
    for name, value in parameters.items():
        default = defaults.get(name)
        same = value == default
        table.add_row(
            name,
            f"{value:g}",
            "" if default is None else f"{default:g}",
            style="" if same else "bold",
        )
    return table
