"""The lowest height: one for the ground tool and both applets."""

import re

import pytest

from echowing.flight.lowest import LOWEST_M
from echowing.paths import shipped


@pytest.mark.parametrize("applet", ["echowing.lua", "echowing_speed.lua"])
def test_the_applets_know_the_same_lowest_height(applet: str) -> None:
    text = shipped(applet).read_text(encoding="utf-8")
    assert [float(one) for one in re.findall(r"local LOWEST_M = ([\d.]+)", text)] == [LOWEST_M]
    # Half a metre less is theirs: at the lowest height itself a barometer would take it away.
    assert text.count("get_relative_position_D_home() > LOWEST_M - 0.5") == 1
