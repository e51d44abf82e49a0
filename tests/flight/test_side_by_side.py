"""Two logs side by side: what they were made with comes out again."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from . import side_by_side
from .side_by_side import FIX_3D, FRAME, MARK, apart, drawn, forgets_s, read

SIGMA_M, TAU_S, HOURS = 1.0, 40.0, 8
LAT_DEG, METRES_PER_DEG = 47.0, 111_180.0  # of latitude, there
DRIVES_MPS, LATE_S = 10.0, 0.1


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two receivers that drift, on a car that goes back and forth; one's time is late."""
    chance, folder = np.random.default_rng(1), tmp_path_factory.mktemp("logs")
    paths = []
    for name, late_s in (("a", 0.0), ("b", LATE_S)):
        rows = np.zeros(HOURS * 3600, FRAME)
        drift_m = chance.normal(0.0, SIGMA_M, 2)
        keep = math.exp(-1.0 / TAU_S)
        for second in range(len(rows)):
            kick_m = chance.normal(0.0, SIGMA_M * math.sqrt(1.0 - keep * keep), 2)
            drift_m = keep * drift_m + kick_m
            phase = math.tau * (second - late_s) / 600.0
            north_m = DRIVES_MPS * 600.0 / math.tau * math.sin(phase) + drift_m[0]
            rows[second]["lat_1e7"] = round((LAT_DEG + north_m / METRES_PER_DEG) * 1e7)
            east = METRES_PER_DEG * math.cos(math.radians(LAT_DEG))
            rows[second]["lon_1e7"] = round((8.0 + drift_m[1] / east) * 1e7)
            speed_mps = DRIVES_MPS * math.cos(phase)
            rows[second]["speed_mmps"] = round(abs(speed_mps) * 1000.0)
            rows[second]["course_1e5"] = 0 if speed_mps >= 0.0 else 18_000_000
        rows["mark"], rows["fix"] = int.from_bytes(MARK, "little"), FIX_3D
        rows["unix_ms"] = 1_700_000_000_000 + 1000 * np.arange(len(rows))
        paths.append(folder / f"{name}.oao")
        paths[-1].write_bytes(b"\x01" * 99 + rows.tobytes())
    return paths


def test_sigma_and_time_constant_come_out_again(logs: list[Path]) -> None:
    """Eight hours are 700 time constants: a twentieth of sigma, and more of its time constant."""
    first, second = map(read, logs)
    off_m = apart(first, second, skip_s=900.0)

    assert len(off_m) == HOURS * 3600 - 900
    assert off_m.std(axis=0) / math.sqrt(2.0) == pytest.approx([SIGMA_M] * 2, rel=0.1)
    assert forgets_s([off_m]) == pytest.approx([TAU_S] * 2, rel=0.25)


def test_receivers_are_drawn_as_they_are_asked_for() -> None:
    """Forty pairs of an hour are 1600 time constants of each axis: as for the logs above."""
    pairs = drawn(1.5, 90.0)

    assert np.std(pairs) / math.sqrt(2.0) == pytest.approx(1.5, rel=0.05)
    assert forgets_s(pairs) == pytest.approx([90.0] * 2, rel=0.25)


def test_a_row_is_printed(
    logs: list[Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["side_by_side", *map(str, logs), "--skip-s", str(HOURS * 3600 - 700)]
    monkeypatch.setattr(sys, "argv", arguments)
    side_by_side.main()

    said = capsys.readouterr().out
    assert "pairs 1, 12 min each" in said
    assert "of 2 x 4 min" in said
