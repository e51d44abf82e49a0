"""What an installed package leaves out: extras, and how each is added (`pip install echowing`)."""

from importlib.util import find_spec

from echowing.errors import EchowingError

# Which libraries each brings, as in pyproject.toml (a test compares), and how to add it.
LIBRARIES = {
    "sim": ("lupa",),
    "campaign": ("dask", "distributed", "pyarrow"),
    "plan": ("scipy",),
    "plots": ("plotly",),
}
# The simulator flies what `make` builds, with a Lua of 32-bit numbers: not from a package alone.
_IN_A_CLONE = (
    "clone the repository and run `make setup core emulated` there, which adds it and builds the "
    "firmware that it flies"
)
HOW = {
    "sim": _IN_A_CLONE,
    "campaign": _IN_A_CLONE,
    "plan": "pip install 'echowing[plan]'",
    "plots": "pip install 'echowing[plots]'",
}


def require(extra: str) -> None:
    """Raise an EchowingError that names the extra if a library of it is missing."""
    if not all(map(find_spec, LIBRARIES[extra])):
        raise _needs(extra)


def needed_for(library: str) -> EchowingError | None:
    """The error where a library was looked for in vain; None: it belongs to no extra."""
    extra = next((extra for extra, names in LIBRARIES.items() if library in names), None)
    return None if extra is None else _needs(extra)


def _needs(extra: str) -> EchowingError:
    return EchowingError(f"this needs the extra [{extra}]: {HOW[extra]}")


def lacks_plots() -> str:
    """What to say of a page that has none; empty where plots can be made."""
    if find_spec("plotly"):
        return ""
    return f"no plots in it: they need the extra [plots], {HOW['plots']}"
