"""Writes what `check` finds wrong, after storing the old values in a file; and restores them.

Fail-safes and fence are never written: their right values depend on the field and on how the pilot
flies. `check` only reports them.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from echowing.errors import EchowingError
from echowing.flight.by_sonar import applet_by_sonar
from echowing.setup.readout import Readout
from echowing.setup.settings import same, settings_for

FORMAT = "echowing parameters 1"
SUFFIX = ".params.json"
# What PARAM_SET can carry: a 32-bit float, and a name that is cut where it is longer.
MOST_VALUE, NAME_BYTES = 3.402823e38, 16


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter to write. restart: it takes effect from the autopilot's next start on."""

    name: str
    old: float
    new: float
    why: str = ""
    restart: bool = False


@dataclass(frozen=True, slots=True)
class Saved:
    """Old values of a vehicle, from a file. when: time of saving, ISO 8601."""

    system_id: int
    parameters: Mapping[str, float]
    when: str = ""


@dataclass(slots=True)
class Outcome:
    """The result of writing; refused: parameters with another value than the one written."""

    written: list[str] = field(default_factory=list)
    refused: dict[str, float] = field(default_factory=dict)


Write = Callable[[str, float], float]
"""Writes a parameter and returns its new value; raises EchowingError if nobody answers."""


def changes_for(readout: Readout) -> list[Change]:
    """What must be written: settings that exist and are wrong, except spared ones."""
    return [
        Change(one.name, value, one.fixed(value), one.why, one.restart)
        for one in settings_for(readout)
        if (value := readout.parameters.get(one.name)) is not None
        and not one.fits(value)
        and not one.spared(value)
    ]


def hidden_for(readout: Readout) -> dict[str, float]:
    """Settings that exist only after a restart, with the value to write if one is wrong then."""
    hidden = {
        one.name: one.fixed(0.0)
        for one in settings_for(readout)
        if one.name not in readout and not one.optional and _shows_later(one.name, readout)
    }
    if "ECHO_ENABLE" not in readout and readout.applet_on_card is not None:
        hidden["ECHO_ENABLE"] = 1.0
        if readout.sonar_named:
            by_sonar = applet_by_sonar(readout.sonar)
            hidden |= {name: one.value for name, one in by_sonar.items()}
    return hidden


def _shows_later(name: str, readout: Readout) -> bool:
    """Whether a switch in the read-out hides this parameter."""
    switch = f"RNGFND{readout.rangefinder}_TYPE" if name.startswith("RNGFND") else "SCR_ENABLE"
    return name != switch and name.startswith(("RNGFND", "SCR_")) and switch in readout


def default_file(system_id: int, now: datetime) -> Path:
    """Default file for the old values."""
    return Path(f"echowing-{system_id}-{now:%Y%m%d-%H%M%S}{SUFFIX}")


def save(path: Path, system_id: int, changes: Iterable[Change], now: datetime) -> None:
    """Store the old values in a file; it is complete when this returns.

    An existing file of this vehicle is extended; its values are older and are kept. Raises
    EchowingError for any other file, or if it cannot be written.
    """
    older = _older(path, system_id)
    news = {change.name: change.old for change in changes if change.name not in older.parameters}
    content = {
        "format": FORMAT,
        "system_id": system_id,
        "saved": older.when or now.isoformat(timespec="seconds"),
        # In the order of writing, as it is put back in reverse.
        "parameters": {**older.parameters, **news},
    }
    arriving = path.with_name(path.name + ".part")
    try:
        with arriving.open("w", encoding="utf-8") as file:
            json.dump(content, file, indent=2)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        arriving.replace(path)
    except OSError as error:
        raise EchowingError(
            f"{path}: the old values cannot be written there: {error.strerror}; nothing was changed"
        ) from error


def _older(path: Path, system_id: int) -> Saved:
    """The values in an existing file; none if there is no file."""
    if not path.exists():
        return Saved(system_id, {})
    saved = load(path)
    if saved.system_id != system_id:
        raise EchowingError(
            f"{path}: exists already, with values of vehicle {saved.system_id}; name another file"
        )
    return saved


def others_of(file: Path, system_id: int) -> list[tuple[Path, str]]:
    """Other files of a vehicle beside `file` with the time of each, the newest first."""
    found = []
    for path in file.resolve().parent.glob(f"*{SUFFIX}"):
        if path == file.resolve():
            continue
        try:
            saved = load(path)
        except EchowingError:
            continue
        if saved.system_id == system_id:
            found.append((path, saved.when))
    return sorted(found, key=lambda one: one[1], reverse=True)


def load(path: Path) -> Saved:
    """Old values from a file. Raises EchowingError that says what is wrong with it."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EchowingError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise EchowingError(f"{path}: not a file of saved parameters: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise EchowingError(f"{path}: not a file of `echowing setup apply` ({FORMAT!r})")
    parameters: Any = content.get("parameters")
    system_id = content.get("system_id")
    if not isinstance(system_id, int) or not _are_values(parameters):
        raise EchowingError(f"{path}: has no system id, or a parameter that is no number")
    values = {name: float(value) for name, value in parameters.items()}
    return Saved(system_id, values, str(content.get("saved", "")))


def _are_values(parameters: Any) -> bool:
    return isinstance(parameters, dict) and all(
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) <= MOST_VALUE
        and len(name.encode()) <= NAME_BYTES
        for name, value in parameters.items()
    )


def write_all(
    values: Sequence[tuple[str, float]], write: Write, progress: Callable[[str], None]
) -> Outcome:
    """Write values one after the other, each read back. `progress` gets each name before.

    Raises EchowingError if the vehicle is lost; values written before that stay written.
    """
    outcome = Outcome()
    for name, value in values:
        progress(name)
        now = write(name, value)
        if same(now, value):
            outcome.written.append(name)
        else:
            outcome.refused[name] = now
    return outcome
