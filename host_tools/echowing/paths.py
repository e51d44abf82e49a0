"""Where files of the other folders are: in the checkout, or beside an installed package."""

from pathlib import Path

from echowing.errors import EchowingError

# The sonar file that counts where none is named (`sonars/`).
SHIPPED_SONAR = "mb1202"


def repository_root() -> Path:
    """The checkout this package is installed from (an editable install, as `make` does it)."""
    root = Path(__file__).resolve().parents[2]
    if not (root / "lua").is_dir():
        raise EchowingError(
            "this needs the firmware and its emulators, which an installed package does not "
            "contain: clone the repository and run `make setup core emulated` there"
        )
    return root


def shipped(name: str) -> Path:
    """A file of another folder that the package takes with it (`shipped/`, links to the files)."""
    return (Path(__file__).parent / "shipped" / name).resolve()


def lua_folder() -> Path:
    """The applets for the SD card."""
    return repository_root() / "lua"
