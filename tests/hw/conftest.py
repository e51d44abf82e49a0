import fcntl
import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "hw"))

from hwtools import mount, rig


@pytest.fixture(scope="session")
def solids(tmp_path_factory: pytest.TempPathFactory) -> rig.Rig:
    """The mount's solids, made afresh from mount.scad: by the first of the workers that asks."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "solids"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return rig.load_rig(folder)


@pytest.fixture(scope="session")
def fresh_parts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The printed parts' STL files, made afresh."""
    folder = tmp_path_factory.mktemp("parts")
    paths = {part: folder / f"{part}.stl" for part in mount.PARTS}
    for part, path in paths.items():
        mount.export_stl(part, path)
    return paths
