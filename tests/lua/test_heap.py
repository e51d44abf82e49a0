"""Each applet loads and flies in the memory that its autopilots have; and the measure is right.

Lua runs on a 32-bit processor here (QEMU), see heap.py.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.lua import heap

from echowing.applets import APPLETS, Applet
from echowing.paths import lua_folder

pytestmark = pytest.mark.seconds(25)

SMALL = """
local kept = {}
%s
local function update() return kept and update, 50 end
return update, 50
"""

PLENTY = 204_800
Measure = Callable[..., heap.Need]
VERSIONS = {heap.NEWEST: (4, 8), heap.MIDDLE: (4, 6), heap.OLDEST: (4, 5)}


@pytest.fixture
def needs(tmp_path: Path) -> Measure:
    """What a small script with these lines needs where there is plenty.

    heap_bytes: the heap it flies in; 0: its least one is looked for, too, in dozens of flights.
    """

    def measured(lines: str, firmware: str = heap.NEWEST, heap_bytes: int = PLENTY) -> heap.Need:
        applet, record = tmp_path / "small.lua", tmp_path / "record"
        applet.write_text(SMALL % lines, encoding="utf-8")
        heap.record_start(applet, record)
        return heap.fly_recorded(applet, record, heap_bytes, firmware)

    return measured


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A flight of each applet, to be flown again in any heap."""
    folder = tmp_path_factory.mktemp("flights")
    records = {applet.file: folder / applet.name for applet in APPLETS}
    for file, record in records.items():
        heap.record_flight(lua_folder() / file, record)
    return records


def test_each_applet_on_a_card_has_its_heap() -> None:
    assert {applet.file for applet in APPLETS} == {file.name for file in lua_folder().glob("*.lua")}


@pytest.mark.parametrize(
    "more_bytes", [0, *(pytest.param(more, marks=pytest.mark.long) for more in (512, 1024))]
)
@pytest.mark.parametrize("firmware", heap.FIRMWARES)
@pytest.mark.parametrize("applet", APPLETS, ids=[applet.name for applet in APPLETS])
def test_an_applet_loads_and_flies_in_its_heap(
    recorded: dict[str, Path], applet: Applet, firmware: str, more_bytes: int
) -> None:
    """And in the next larger ones, where blocks lie elsewhere and holes are others."""
    script, record = lua_folder() / applet.file, recorded[applet.file]
    heap_bytes = applet.needs_bytes(VERSIONS[firmware]) + more_bytes
    flight = heap.fly_recorded(script, record, heap_bytes, firmware)
    assert flight.trouble is None, (
        f"{applet.file} in {heap_bytes} bytes, {firmware}: {flight.trouble}; "
        f"see python -m tests.lua.heap {script}"
    )
    assert flight.updates > 300  # 25 s in the air, 20 a second and more; 2 s on the ground


def test_older_versions_fill_more_of_it(needs: Measure) -> None:
    """SITL 4.6 tells 8.9 kB at 64 bit, without headers: classes of which no script uses most.

    What made 4.6 smaller than 4.5 saved 9.3, 2 and 2.9 kB by its commits (b64ed6ca56, 9cbec043d0,
    8e303675fe).
    """
    newest, middle, oldest = (needs("", one).load_peak_bytes for one in heap.FIRMWARES)
    assert middle - newest > 6000
    assert 12_000 < oldest - middle < 18_000


def test_older_versions_have_a_library_more(needs: Measure) -> None:
    """UTF-8, until 4.6."""
    taken_off = "utf8 = nil"
    newest, middle, oldest = (
        needs("", one).live_bytes - needs(taken_off, one).live_bytes for one in heap.FIRMWARES
    )
    assert newest <= 0
    assert min(middle, oldest) > 300


def test_a_script_has_a_string_library_of_its_own(needs: Measure) -> None:
    """A table of 16 functions has room for 32; texts find the vehicle's own."""
    given_back = "string = nil kept[1] = ('x'):rep(2)"
    assert needs("kept[1] = ('x'):rep(2)").live_bytes - needs(given_back).live_bytes > 32 * 20


def test_a_heap_that_is_too_small_is_told(recorded: dict[str, Path]) -> None:
    default_bytes = 43 * 1024  # of an F427
    file = "echowing.lua"
    too_small = heap.fly_recorded(lua_folder() / file, recorded[file], default_bytes)
    assert "not enough memory" in (too_small.trouble or "")


def test_numbers_and_pointers_take_32_bits(needs: Measure) -> None:
    one = needs("kept[1] = kept", heap_bytes=0)
    thousand = needs("for i = 1, 1000 do kept[i] = kept end", heap_bytes=0)
    # A value takes 8 bytes, and a table with 1000 of them has room for 1024.
    assert thousand.live_bytes - one.live_bytes == 1023 * 8
    # While it grows, half of it is there twice.
    assert thousand.least_bytes - one.least_bytes > (1023 + 512 - 1) * 8


def test_the_compilers_table_of_words_doubles_when_it_is_full(needs: Measure) -> None:
    def with_names(count: int) -> heap.Need:
        return needs("\n".join(f"kept.n{i} = nil" for i in range(count)))

    hundred = with_names(100)
    assert with_names(130).words == hundred.words + 30
    full, over = (with_names(100 + 256 - hundred.words + more) for more in (0, 1))
    assert (full.words, over.words) == (256, 257)
    assert over.load_peak_bytes - full.load_peak_bytes > 256 * 20  # bytes of an entry


def test_a_block_has_a_header_and_is_moved_to_grow(needs: Measure) -> None:
    """ChibiOS: 8 bytes before each block, and whole 8 bytes; Lua's string: 16 and a zero."""
    many = "for i = 1, 100 do kept[i] = string.rep('x', {}) .. i + 100 end"
    none = needs(many.format(0))
    for letters, block_bytes in ((44, 64), (45, 72), (52, 72)):
        some = needs(many.format(letters))
        assert some.live_bytes - none.live_bytes == 100 * (block_bytes + 8 - 32), letters


def test_holes_count_as_the_first_that_is_large_enough_is_taken(needs: Measure) -> None:
    """Every second text goes: together they would have room for the long one."""
    holes = """
for i = 1, 300 do kept[i] = string.rep('x', 100) .. i end
for i = 1, 300, 2 do kept[i] = nil end
"""
    short = needs(holes + "kept[1] = string.rep('y', 60)", heap_bytes=0)
    long = needs(holes + "kept[1] = string.rep('y', 12000)", heap_bytes=0)
    assert long.peak_bytes < 204800
    assert long.least_bytes - short.least_bytes > 12000


@pytest.mark.parametrize(
    ("lines", "trouble"),
    [
        ("\n".join(f"local v{i} = {i}" for i in range(101)), "limit is 100"),
        ("select('#', 1)", "'select'"),
        ("string.dump(print)", "'dump'"),
        ("vehicle:no_such_call()", "'no_such_call'"),
        ("millis()", "called :millis, recorded is"),
        ("while true do end", "Exceeded CPU time"),
    ],
)
def test_the_engine_is_the_vehicles(tmp_path: Path, lines: str, trouble: str) -> None:
    good, bad, record = tmp_path / "good.lua", tmp_path / "bad.lua", tmp_path / "record"
    good.write_text(SMALL % "", encoding="utf-8")
    bad.write_text(SMALL % lines, encoding="utf-8")
    heap.record_start(good, record)
    assert heap.fly_recorded(good, record).trouble is None
    assert trouble in (heap.fly_recorded(bad, record).trouble or "")
