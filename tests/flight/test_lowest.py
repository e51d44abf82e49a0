"""The lowest height: one for the ground tool and both applets."""

import re

import pytest

from echowing.flight.lowest import LOWEST_M
from echowing.paths import shipped


@pytest.mark.parametrize("applet", ["echowing.lua", "echowing_speed.lua"])
def test_the_applets_know_the_same_lowest_height(applet: str) -> None:
    text = shipped(applet).read_text(encoding="utf-8")
    # Half a metre less is theirs: at the lowest height itself a barometer would take it away. The
    # speed applet has no name for it: names take memory.
    rule = r"get_relative_position_D_home\(\) > (?:LOWEST_M|([\d.]+)) - 0\.5"
    found = re.findall(r"local LOWEST_M = ([\d.]+)", text) + re.findall(rule, text)
    assert [float(one) for one in found if one] == [LOWEST_M]
    assert len(re.findall(rule, text)) == 1
