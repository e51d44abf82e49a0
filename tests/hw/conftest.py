import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "hw"))

from hwtools import mount, rig


@contextmanager
def made_once(factory: pytest.TempPathFactory, name: str) -> Iterator[Path]:
    """A folder that all workers share; the first of them that comes fills it, others wait."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield folder


@pytest.fixture(scope="session")
def solids(tmp_path_factory: pytest.TempPathFactory) -> rig.Rig:
    """The mount's solids, made afresh from mount.scad."""
    with made_once(tmp_path_factory, "solids") as folder:
        return rig.load_rig(folder)


@pytest.fixture(scope="session")
def fresh_parts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The printed parts' STL files, made afresh."""
    with made_once(tmp_path_factory, "parts") as folder:
        paths = {part: folder / f"{part}.stl" for part in mount.PARTS}
        for part, path in paths.items():
            if not path.exists():
                mount.export_stl(part, path)
        return paths
