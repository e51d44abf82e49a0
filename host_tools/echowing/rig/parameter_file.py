"""Parameters in a file: a line each, NAME,VALUE, as ground stations write them."""

import math
from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten

from echowing.errors import EchowingError
from echowing.rig.board import as_float32


def write_parameters(path: Path, values: Mapping[str, float], head: str) -> None:
    """Write them with a comment on top; the file is there whole, or as it was before."""
    # Nine digits bring every 32-bit number back as it was.
    lines = [f"# {head}", *(f"{name},{value:.9g}" for name, value in values.items())]
    draft = path.with_name(f"{path.name}.part")
    try:
        draft.write_text("\n".join(lines) + "\n", encoding="utf-8")
        draft.replace(path)
    except OSError as error:
        raise EchowingError(f"{path}: cannot be written ({error.strerror})") from error


def read_parameters(path: Path) -> dict[str, float]:
    """Read them; name and value apart by comma or blanks, `#` begins a comment.

    Raises EchowingError that names the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise EchowingError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise EchowingError(f"{path}: is not a text file of parameters") from error
    values: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        name, value = _row(words, f"{path}, line {number}")
        if name in values:
            raise EchowingError(f"{path}, line {number}: {name} is given twice")
        values[name] = value
    if not values:
        raise EchowingError(f"{path}: holds no parameters; a line is NAME,VALUE")
    return values


def _row(words: list[str], where: str) -> tuple[str, float]:
    try:
        name, number = words
        value = as_float32(float(number))
    except (ValueError, OverflowError) as error:
        line = shorten(" ".join(words), 60, placeholder=" …")
        raise EchowingError(f"{where}: a line is NAME,VALUE, not {line!r}") from error
    if not math.isfinite(value):
        raise EchowingError(f"{where}: {name} has to be a number, not {number}")
    return name, value
