"""Where the other rooms of the checkout are."""

from pathlib import Path

from echowing.errors import EchowingError


def repository_root() -> Path:
    """The checkout this package is installed from (an editable install, as `make` does it)."""
    root = Path(__file__).resolve().parents[2]
    if not (root / "lua").is_dir():
        raise EchowingError(
            f"{root}: no Echowing checkout here; install with `make setup` in a clone"
        )
    return root


def lua_folder() -> Path:
    """The applets for the SD card."""
    return repository_root() / "lua"
