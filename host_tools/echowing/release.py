"""A release as `make release` writes it: wheel, firmware and applets in one folder, with checksums.

Whoever takes a file from it gets it only if it is what the checksum says.
"""

import hashlib
import re
from pathlib import Path

from echowing import __version__
from echowing.errors import EchowingError

# As `sha256sum` writes and checks it: `sha256sum -c SHA256SUMS` in the folder.
SUMS = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64})  ([\w.+-]+)")
_WHEEL = re.compile(r"echowing-(.+?)-py3-none-any\.whl")


# What a board's flasher takes, by the family of the board.
IMAGE_KINDS = {"avr": "hex", "stm32": "bin"}


def firmware_file(board: str, kind: str) -> str:
    """The name of a board's image."""
    return f"echowing-{board}.{kind}"


def sum_of(path: Path) -> str:
    """A file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Release:
    """A folder with a release of these tools' version."""

    def __init__(self, folder: Path) -> None:
        """Raises EchowingError where there is none, or another version's."""
        self._folder = folder
        try:
            lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise EchowingError(
                f"{folder}: no release there: its {SUMS} cannot be read; `make release` writes one"
            ) from error
        rows = [_LINE.fullmatch(line) for line in lines]
        self._sums = {row.group(2): row.group(1) for row in rows if row is not None}
        version = next((m.group(1) for m in map(_WHEEL.fullmatch, self._sums) if m), None)
        if None in rows or version is None:
            raise EchowingError(f"{folder / SUMS}: not as `make release` writes it")
        if version != __version__:
            raise EchowingError(
                f"{folder}: this is release {version}, and the tools here are {__version__}; "
                "vehicles and tools take the same one: install the wheel in that folder first"
            )

    def verified(self, name: str) -> Path:
        """A file of it; EchowingError where it is missing, or is not what its checksum says."""
        path = self._folder / name
        if name not in self._sums or not path.is_file():
            raise EchowingError(f"{self._folder}: this release has no {name}")
        if sum_of(path) != self._sums[name]:
            raise EchowingError(
                f"{path}: not the file of this release, as its checksum differs from {SUMS}: "
                "nothing is written; copy the release again"
            )
        return path
