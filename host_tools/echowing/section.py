"""What a section of a user's TOML file is: fixed once read, and without keys that nobody knows."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class Section(BaseModel):
    """A section of a scenario or of a formation file."""

    # What stands under a field describes it, also on the page of keys (sim/scenario_page.py).
    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
