import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "hw"))

from hwtools import mount, rig


@pytest.fixture(scope="session")
def solids(tmp_path_factory: pytest.TempPathFactory) -> rig.Rig:
    """The mount's solids, made afresh from mount.scad."""
    return rig.load_rig(tmp_path_factory.mktemp("solids"))


@pytest.fixture(scope="session")
def fresh_parts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The printed parts' STL files, made afresh."""
    folder = tmp_path_factory.mktemp("parts")
    paths = {part: folder / f"{part}.stl" for part in mount.PARTS}
    for part, path in paths.items():
        mount.export_stl(part, path)
    return paths
