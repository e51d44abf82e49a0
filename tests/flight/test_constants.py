"""The page of the flight core's constants: complete, current, and each with its reason."""

from pathlib import Path

import pytest

from echowing.docs.constants import FOLDER, NAME, constants_of, page
from echowing.errors import EchowingError

PAGE = Path(__file__).parents[2] / "host_tools" / NAME


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make pages`"


@pytest.mark.parametrize(
    ("source", "rows"),
    [
        ("# Why.\nJOIN_MPS, CATCH_UP_PER_S = 1.5, 0.5\n", [("JOIN_MPS CATCH_UP_PER_S", "Why.")]),
        (
            "# One,\n# and on.\nJOIN_MPS = 1.5\nSLACK_M = 0.3\n",
            [("JOIN_MPS SLACK_M", "One, and on.")],
        ),
        ("# A.\nJOIN_MPS = 1.5\n# B.\nSLACK_M = 0.3\n", [("JOIN_MPS", "A."), ("SLACK_M", "B.")]),
        ("# A.\nJOIN_MPS = 1.5\nSLACK_M = 0.3  # B.\n", [("JOIN_MPS", "A."), ("SLACK_M", "B.")]),
        ("x = 1.0\ndef f() -> None:\n    SLACK_M = 0.3\n", []),
    ],
)
def test_numbers_share_the_comment_above_them(
    tmp_path: Path, source: str, rows: list[tuple[str, str]]
) -> None:
    file = tmp_path / "plan.py"
    file.write_text(source, encoding="utf-8")
    assert [(" ".join(one.numbers), one.reason) for one in constants_of(file)] == rows


@pytest.mark.parametrize("source", ["JOIN_MPS = 1.5\n", "# Of another.\n\nJOIN_MPS = 1.5\n"])
def test_a_number_without_a_reason_is_refused(tmp_path: Path, source: str) -> None:
    file = tmp_path / "plan.py"
    file.write_text(source, encoding="utf-8")
    with pytest.raises(EchowingError, match=r"plan.py:\d: JOIN_MPS has no comment above it"):
        list(constants_of(file))


def test_all_modules_of_the_core_are_on_it() -> None:
    modules = [file.stem for file in sorted(FOLDER.glob("*.py")) if list(constants_of(file))]
    assert len(modules) > 30
    assert all(f"\n## `{module}.py`\n" in page() for module in modules)
