"""Like receivers that were carried side by side: how they drift apart, and what is learnt of that.

    .venv/bin/python -m tests.flight.side_by_side [--skip-s 900] A.oao B.oao …
    .venv/bin/python -m tests.flight.side_by_side --drawn SIGMA_M TAU_S

Each file is a receiver's log of the same time (.oao as Logiqx/gps-wizard describes it, NAV-PVT of a
u-blox in the recordings of RESULTS.md). Every two of them are compared once a second. What is
learnt is `flight.receivers`', shown stretches of four minutes along a line that turns. `--drawn`
compares receivers that drift as `flight.receivers` believes, of that size and time constant.
"""

import argparse
import copy
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymap3d import geodetic2ned

from echowing.flight.cloud import PLACED_SIGMA_M, Wandering
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.receivers import FOLLOWS_S, Receivers, passing

Floats = NDArray[np.float64]

FRAME = np.dtype(
    [
        *(("mark", "<u2"), ("checksum", "<u2")),
        *(("lat_1e7", "<i4"), ("lon_1e7", "<i4"), ("alt_mm", "<i4")),
        *(("speed_mmps", "<u4"), ("course_1e5", "<i4"), ("unix_ms", "<i8")),
        *(("fix", "u1"), ("rest", "V19")),
    ]
)
MARK, FIX_3D = b"\xd4\x0a", 3
DAY_MS = 86_400_000
STRETCH_S, TELLS_FROM_S, AHEAD_S, TURNS_RPS = 240, 30, (10, 20), 0.05
# Mean squared changes over these are fitted: less is the receiver's own smoothing.
OVER_S = (10, 20, 30, 60, 90, 120, 180, 240, 300, 450, 600)
# As of a sonar of which one reading in twenty is wrong and says anything within 5 m.
WRONG_PER_M = 0.05 / 5.0
FASTEST_S, SLOWEST_S = 5.0, 1000.0
DRAWN, DRAWN_S = 40, 3600


class Log(NamedTuple):
    """Whole seconds, position (n, 2) degrees, and velocity (n, 2) m/s, north and east."""

    second: NDArray[np.int64]
    place_deg: Floats
    velocity_mps: Floats


def read(path: Path) -> Log:
    """A log's fixes on whole seconds."""
    data = path.read_bytes()
    starts = [n for n in range(len(data) - FRAME.itemsize + 1) if data[n : n + 2] == MARK]
    phase = max(range(FRAME.itemsize), key=[n % FRAME.itemsize for n in starts].count)
    frames = [data[n : n + FRAME.itemsize] for n in starts if n % FRAME.itemsize == phase]
    rows = np.frombuffer(b"".join(frames), FRAME)
    on_day = abs(rows["unix_ms"] - np.median(rows["unix_ms"])) < DAY_MS
    rows = rows[(rows["fix"] == FIX_3D) & on_day & (rows["unix_ms"] % 1000 == 0)]
    second, first = np.unique(rows["unix_ms"] // 1000, return_index=True)
    rows = rows[first]
    course_rad, speed_mps = np.radians(rows["course_1e5"] * 1e-5), rows["speed_mmps"] * 1e-3
    return Log(
        second,
        np.stack((rows["lat_1e7"], rows["lon_1e7"]), axis=1) * 1e-7,
        np.stack((np.cos(course_rad), np.sin(course_rad)), axis=1) * speed_mps[:, None],
    )


def apart(a: Log, b: Log, skip_s: float) -> Floats:
    """What they say differently, (n, 2) metres, second by second; gaps are bridged.

    One constant difference of their times is taken off: as they move, it is a difference of place.
    """
    both, in_a, in_b = np.intersect1d(a.second, b.second, return_indices=True)
    counts = both >= both[0] + skip_s
    here_deg, there_deg = a.place_deg[in_a][counts], b.place_deg[in_b][counts]
    ned_m = geodetic2ned(*there_deg.T, 0.0, *here_deg.T, 0.0)
    off_m = np.stack(ned_m[:2], axis=1)
    moves = a.velocity_mps[in_a][counts]
    moves = moves - moves.mean(axis=0)
    later_s = (moves * (off_m - off_m.mean(axis=0))).sum() / max((moves**2).sum(), 1e-9)
    off_m = off_m - later_s * a.velocity_mps[in_a][counts]
    every = np.arange(both[counts][0], both[counts][-1] + 1)
    return np.stack([np.interp(every, both[counts], axis) for axis in off_m.T], axis=1)


def drawn(sigma_m: float, tau_s: float) -> list[Floats]:
    """`DRAWN` pairs' differences, (n, 2) metres: what their autopilots, which follow, believe."""
    chance, kept = np.random.default_rng(1), math.exp(-1.0 / tau_s)
    left, part = passing(1.0, FOLLOWS_S)
    drift_m = chance.normal(0.0, math.sqrt(2.0) * sigma_m, (DRAWN, 2))
    believed_m, every = drift_m, []
    for _ in range(DRAWN_S):
        kick_m = chance.normal(0.0, sigma_m * math.sqrt(2.0 - 2.0 * kept * kept), (DRAWN, 2))
        believed_m = left * believed_m + (1.0 - left) * kept * drift_m + part * kick_m
        drift_m = kept * drift_m + kick_m
        every.append(believed_m)
    return list(np.stack(every, axis=1))


def forgets_s(pairs: Sequence[Floats]) -> Floats:
    """Time constant, north and east, of the first-order process that changes as they do."""
    over_s = [s for s in OVER_S if s < 0.5 * min(map(len, pairs))]
    changed = np.array(
        [np.mean([((one[s:] - one[:-s]) ** 2).mean(axis=0) for one in pairs], 0) for s in over_s]
    )
    taus_s = np.geomspace(FASTEST_S, SLOWEST_S, 400)
    shape = 1.0 - np.exp(-np.array(over_s)[:, None] / taus_s)
    size = (changed[:, None, :] * shape[:, :, None]).sum(0) / (shape**2).sum(0)[:, None]
    left = ((changed[:, None, :] - size * shape[:, :, None]) ** 2).sum(0)
    return np.asarray(taus_s[left.argmin(axis=0)])


def beyond(stretch: Floats) -> Iterator[bool]:
    """Whether each of what was foretold in a stretch was off by more than `SURE_SIGMAS`."""
    believed = Wandering()
    learnt = Receivers(believed.sigma_m, believed.sigma_spread, believed.tau_s)
    for second in range(STRETCH_S):
        along = math.cos(TURNS_RPS * second), math.sin(TURNS_RPS * second)
        off_m = float(stretch[second] @ along)
        learnt.wander(1.0)
        learnt.take(along, off_m, PLACED_SIGMA_M, WRONG_PER_M)
        if second < TELLS_FROM_S:
            continue
        for ahead_s in AHEAD_S:
            mean_m, sigma_m = _foretold(learnt, along, ahead_s)
            off_m = float(stretch[second + ahead_s] @ along) - mean_m
            yield abs(off_m) > SURE_SIGMAS * sigma_m


def _foretold(learnt: Receivers, along: tuple[float, float], ahead_s: int) -> tuple[float, float]:
    """What they will disagree by along a line, and the standard deviation of that."""
    later = copy.deepcopy(learnt)
    later.wander(ahead_s)
    seen = np.array((0.0, 0.0, *along))
    means_m, variances = later._state @ seen, seen @ later._covariance @ seen
    mean_m = float(later.share @ means_m)
    return mean_m, math.sqrt(float(later.share @ (variances + means_m**2)) - mean_m**2)


def main() -> None:
    """Print one line of all pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="*", type=Path)
    parser.add_argument("--drawn", nargs=2, type=float, metavar=("SIGMA_M", "TAU_S"))
    parser.add_argument("--skip-s", type=float, default=900.0, help="seconds left out at first")
    given = parser.parse_args()
    if given.log if given.drawn else len(given.log) < 2:
        parser.error("give two logs or more, or --drawn")
    logs = [read(path) for path in given.log]
    pairs = [apart(a, b, given.skip_s) for a, b in itertools.combinations(logs, 2)]
    if given.drawn:
        pairs = drawn(*given.drawn)
    one_m = 1.0 / math.sqrt(2.0)
    sigma_m = one_m * np.sqrt(np.mean([one.var(axis=0) for one in pairs], axis=0))
    off_m = one_m * np.sqrt(np.mean([(one**2).mean(axis=0) for one in pairs], axis=0))
    furthest_m = max(np.linalg.norm(one - one.mean(axis=0), axis=1).max() for one in pairs)
    needed = STRETCH_S + max(AHEAD_S)
    stretches = [one[n : n + needed] for one in pairs for n in range(0, len(one) - needed, needed)]
    share = np.mean([one for stretch in stretches for one in beyond(stretch)])
    print(f"pairs {len(pairs)}, {np.mean([len(one) for one in pairs]) / 60.0:.0f} min each")
    print("one receiver, north and east:")
    print(f"  sigma {sigma_m.round(2)} m, about nought {off_m.round(2)} m")
    print(f"  forgets in {forgets_s(pairs).round()} s; largest difference {furthest_m:.1f} m")
    print(f"foretold: off by more than {SURE_SIGMAS} sigma {share:.1%} of {len(stretches)} x 4 min")


if __name__ == "__main__":
    main()
