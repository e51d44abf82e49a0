"""What a campaign keeps in its folder: its description, a row for each flight, finds, a report."""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from echowing import __version__
from echowing.campaign.draw import Description
from echowing.campaign.fly import Row
from echowing.errors import EchowingError

HEAD, ROWS, FINDS = "campaign.json", "flights.jsonl", "finds"
REPORT, TABLE = "report.html", "flights.parquet"


@dataclass(frozen=True)
class Folder:
    """A campaign's folder."""

    path: Path

    def begin(self, description: Description, seed: int, *, resume: bool) -> dict[int, Row]:
        """Begin a campaign here, or resume one; returns the flights that are done, by number.

        Raises EchowingError if one is here and `resume` is not set, or if it is another one.
        """
        head = {
            "description": description.text,
            "source": description.source,
            "seed": seed,
            "version": __version__,
        }
        try:
            if not (self.path / HEAD).exists():
                self.path.mkdir(parents=True, exist_ok=True)
                (self.path / HEAD).write_text(json.dumps(head, indent=1), encoding="utf-8")
            elif not resume:
                raise EchowingError(
                    f"--out {self.path}: holds a campaign: go on with --resume, or give another"
                )
            self._check(head)
            return self._done()
        except OSError as error:
            raise EchowingError(f"--out {self.path}: cannot be used: {error.strerror}") from error

    def _check(self, head: dict[str, Any]) -> None:
        try:
            here = json.loads((self.path / HEAD).read_text(encoding="utf-8"))
        except ValueError as error:
            raise EchowingError(f"{self.path / HEAD}: is damaged; give another --out") from error
        for key, what in (("seed", "seed"), ("description", "description"), ("version", "version")):
            if here.get(key) != head[key]:
                shown = f" ({here.get(key)})" if key != "description" else ""
                raise EchowingError(
                    f"--resume: {self.path} holds a campaign of another {what}{shown}: "
                    "give another --out"
                )

    def _done(self) -> dict[int, Row]:
        """Rows that were written whole; the last may have been cut off."""
        rows: dict[int, Row] = {}
        path = self.path / ROWS
        if not path.exists():
            return rows
        whole = 0
        with path.open("rb") as file:
            for line in file:
                try:
                    row = json.loads(line)
                except ValueError:
                    break
                if not line.endswith(b"\n"):
                    break
                whole += len(line)
                rows[row["index"]] = row
        with path.open("rb+") as file:
            file.truncate(whole)
        return rows

    def add(self, row: Row) -> None:
        """Write a flight to the disk. Raises EchowingError if it cannot be written."""
        with self._writing(), (self.path / ROWS).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def sort(self, rows: Iterable[Row]) -> None:
        """Put the rows in the flights' order, so that the workers' order leaves no trace."""
        lines = [json.dumps(row) + "\n" for row in sorted(rows, key=lambda row: row["index"])]
        with self._writing():
            (self.path / ROWS).write_text("".join(lines), encoding="utf-8")

    def write_parquet(self, rows: Iterable[Row]) -> None:
        """flights.parquet: a column for each plain value; lists and tables as Parquet has them."""
        import pyarrow  # noqa: PLC0415 (large; only here)
        from pyarrow import parquet  # noqa: PLC0415

        ordered = sorted(rows, key=lambda row: row["index"])
        table = pyarrow.Table.from_pylist([_column_ready(row) for row in ordered])
        with self._writing():
            parquet.write_table(table, self.path / TABLE)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            why = error.strerror or error
            raise EchowingError(f"--out {self.path}: cannot be written: {why}") from error


def _column_ready(row: Row) -> Row:
    """Tables of seconds by name become lists of pairs: their names are no columns."""
    ready = dict(row)
    for key in ("in_force_s", "states_s"):
        named = row.get(key) or {}
        ready[key] = [{"name": name, "seconds": seconds} for name, seconds in named.items()]
    return ready


def scenario_text(table: dict[str, Any], comments: Iterable[str]) -> str:
    """A scenario file, with comments at its head."""
    head = "".join(f"# {line}".rstrip() + "\n" for line in comments)
    return head + tomli_w.dumps(table)
