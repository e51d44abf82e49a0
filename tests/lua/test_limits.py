"""The applets keep a margin to the limits of the vehicle's Lua."""

from pathlib import Path

import pytest

from echowing.paths import lua_folder
from echowing.sim.vehicle.lua_limits import functions_of

# The vehicle allows 100 locals and 127 upvalues (echowing.sim.vehicle.lua_limits): room to grow.
MOST_LOCALS = 80
MOST_UPVALUES = 60


@pytest.mark.parametrize("script", sorted(lua_folder().rglob("*.lua")), ids=lambda path: path.name)
def test_functions_of_the_applets_are_far_from_the_limits(script: Path) -> None:
    for function in functions_of(script.read_bytes()):
        assert function.most_active <= MOST_LOCALS, function.where
        assert len(function.upvalues) <= MOST_UPVALUES, function.where


def test_what_is_counted() -> None:
    main, first, second = functions_of(
        b"local a, b\n"
        b"do local c, d, e = 1, 2, 3 end\n"
        b"for i = 1, 2 do a = i end\n"
        b"function first(x, ...)\n"
        b"  local y = x\n"
        b"  return function() return y, a, b, first end\n"
        b"end\n"
    )
    assert (main.where, main.most_active) == ("main function", 2 + 4)  # the loop: three and its own
    assert (first.where, first.most_active) == ("function at line 4", 2)
    assert (second.where, second.most_active) == ("function at line 6", 0)
    assert [upvalue.name for upvalue in second.upvalues] == ["y", "a", "b", "_ENV"]
