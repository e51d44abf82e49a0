"""A campaign: flights over workers, rows kept as they come, finds shrunk, a report."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from echowing.campaign.draw import Description, draw, flight_seed
from echowing.campaign.files import FINDS, scenario_text
from echowing.campaign.fly import CRASHED, LOGS, Row, fly_and_judge, fly_one
from echowing.campaign.properties import BLOWN, BLOWN_ON, MISLED, PROPERTIES, Broken
from echowing.campaign.shrink import breaks, shrink, table_of
from echowing.campaign.story import write_story
from echowing.campaign.workers import WorkersDied, done_by_workers
from echowing.errors import EchowingError
from echowing.sim.scenario import load_scenario

if TYPE_CHECKING:
    from distributed import Client

# So many finds of each property, the worst, are shrunk: a hundred of one cause show no more.
SHRUNK_EACH = 5
ORDER = [*PROPERTIES, MISLED, BLOWN, BLOWN_ON, LOGS, CRASHED]

Stop = Callable[[], bool]
OnRow = Callable[[Row], None]


@dataclass(frozen=True)
class Order:
    """What is to be flown, and by whom; scheduler None: `workers` processes of this machine."""

    description: Description
    seed: int
    flights: int
    workers: int
    scheduler: str | None = None


def fly_all(
    order: Order,
    done: Mapping[int, Row],
    keep: OnRow,
    stop: Stop,
    client: "Client",
) -> dict[int, Row]:
    """Fly what is not done yet; each row goes to `keep` once. Returns the rows of all flights."""
    rows = dict(done)
    left = [index for index in range(order.flights) if index not in rows]
    work = (order.description, order.seed)
    for index, result in done_by_workers(client, _fly, work, left, stop):
        rows[index] = _killed(order, index) if isinstance(result, WorkersDied) else result
        keep(rows[index])
    return rows


def _fly(work: tuple[Description, int], index: int) -> Row:
    description, seed = work
    return fly_one(description, seed, index)


def _killed(order: Order, index: int) -> Row:
    text = "each worker that flew it died"
    return {
        "index": index,
        "seed": flight_seed(order.seed, index),
        "broken": [{"name": CRASHED, "time_s": 0.0, "vehicle": 0, "value": 0.0, "text": text}],
    }


def finds_of(rows: Iterable[Row]) -> dict[str, list[tuple[Row, Broken]]]:
    """The flights that broke each property, the worst first, each flight once."""
    found: dict[str, list[tuple[Row, Broken]]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: row["index"]):
        for name in dict.fromkeys(one["name"] for one in row["broken"]):
            first = next(one for one in row["broken"] if one["name"] == name)
            found[name].append((row, Broken(**first)))
    # Of a separation or a height the least value is the worst; of all else the largest.
    for name, entries in found.items():
        sign = 1.0 if name in ("separation", MISLED, BLOWN, "not too low") else -1.0
        entries.sort(key=lambda entry: (sign * entry[1].value, entry[0]["index"]))
    return {name: found[name] for name in ORDER if name in found}


def shrink_all(
    order: Order, rows: Iterable[Row], folder: Path, stop: Stop, client: "Client"
) -> list[Path]:
    """Shrink the worst finds of each property, and write them; existing files stay."""
    folder = folder / FINDS
    chosen = [
        (name, row["index"])
        for name, entries in finds_of(rows).items()
        for row, _ in entries[:SHRUNK_EACH]
    ]
    left = [key for key in chosen if not _find_path(folder, *key).exists()]
    work = (order.description, order.seed)
    for (name, index), text in done_by_workers(client, shrunk_file, work, left, stop):
        if isinstance(text, WorkersDied):
            continue
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = _find_path(folder, name, index)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise EchowingError(f"--out {folder}: cannot be written: {error.strerror}") from error
        write_find_page(path, name)
    return [path for key in chosen if (path := _find_path(folder, *key)).exists()]


def _find_path(folder: Path, name: str, index: int) -> Path:
    return folder / f"{name.replace(',', '').replace(' ', '-')}-{index}.toml"


def shrunk_file(work: tuple[Description, int], key: tuple[str, int]) -> str:
    """The file of a find: its smallest scenario, with a description at its head."""
    (description, seed), (name, index) = work, key
    own_seed = flight_seed(seed, index)
    table, broken = shrink(table_of(draw(description, seed, index)), breaks(name, own_seed))
    file = _find_path(Path(), name, index).name
    table["title"] = f"Find: {broken.text}"
    table.pop("name", None)
    return scenario_text(
        table,
        [
            f"{name}: {broken.text}, at {broken.time_s:.1f} s.",
            f"Flight {index} of the campaign with seed {seed}, shrunk. Fly it again:",
            f"  echowing sim {file} --seed {own_seed}",
        ],
    )


def write_find_page(path: Path, name: str) -> None:
    """Write a find's page beside its file; flown from the file, so that both agree."""
    seed = int(path.read_text(encoding="utf-8").partition("--seed ")[2].split()[0])
    judged = fly_and_judge(load_scenario(str(path)), seed)
    if judged.record is not None:
        title = f"{name}: {path.stem}, seed {seed}"
        write_story(path.with_suffix(".html"), title, judged.record, judged.broken)
