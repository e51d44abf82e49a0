"""What a section of a user's TOML file is: fixed once read, and without keys that nobody knows."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from echowing.errors import EchowingError

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class Section(BaseModel):
    """A section of a scenario, of a formation file or of a sonar file."""

    # What stands under a field describes it, also on the page of keys (docs/keys.py).
    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


Whole = TypeVar("Whole", bound=Section)


def section_of(model: type[Whole], table: Mapping[str, Any], source: str) -> Whole:
    """A file's contents, validated; EchowingError names the source, each key and what is wrong."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        wrong = [one for one in error.errors() if one["type"] != "default_factory_not_called"]
        lines = [_explained(model, item) for item in wrong]
        raise EchowingError("\n".join(f"{source}: {line}" for line in lines)) from error


def _explained(whole: type[Section], item: Any) -> str:
    """One validation error as `key: what is wrong; what is allowed`."""
    location = [str(part) for part in item["loc"]]
    key = ".".join(location) or whole.__name__.lower().removesuffix("section")
    if item["type"] == "extra_forbidden":
        allowed = ", ".join(sorted(_keys_at(whole, location[:-1])))
        return f"{key}: no such key; allowed here: {allowed}"
    if item["type"] == "missing":
        return f"{key}: missing"
    message = item["msg"].removeprefix("Value error, ")
    got = item["input"]
    shown = "" if isinstance(got, dict) else f" (got {got!r})"
    return f"{key}: {message}{shown}"


def _keys_at(whole: type[Section], location: Iterable[str]) -> list[str]:
    """The keys that a section may have."""
    model: type[BaseModel] = whole
    for part in location:
        if part.isdigit():
            continue
        field = model.model_fields.get(part)
        inner = _model_in(field.annotation if field else None)
        if inner is None:
            return []
        model = inner
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_in(inner)
        if found is not None:
            return found
    return None
