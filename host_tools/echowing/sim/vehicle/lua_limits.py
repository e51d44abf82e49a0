"""What ArduPilot's Lua refuses and a stock Lua takes: too many locals or upvalues in one function.

A stock compiler does the counting. Its bytecode (Lua 5.3, `ldump.c`) lists, for each function, the
local variables with the instructions between which each is active, and the upvalues.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from struct import unpack_from
from typing import Any, NamedTuple

from lupa import lua53

# ArduPilot libraries/AP_Scripting/lua/src: MAXVARS in lparser.c (stock 200), MAXUPVAL in lfunc.h
# (stock 255). The same in 4.5 to 4.8.
MOST_LOCALS = 100
MOST_UPVALUES = 127

# lopcodes.h: operation codes in the lowest 6 bits, then A in 8 bits, C and B in 9 bits each.
_GETUPVAL, _GETTABUP, _SETTABUP, _SETUPVAL, _CLOSURE = 5, 6, 8, 9, 44
# The constants of a dump that have a value, lobject.h: its size in bytes; a string has its own.
_CONSTANT_BYTES = {0: 0, 1: 1, 3: 4, 0x13: 4}  # nil, boolean, 32-bit float, 32-bit integer
# "\x1bLua", version, format, check bytes, five sizes, a test integer, a test float, upvalues.
_HEADER_BYTES = 4 + 2 + 6 + 5 + 4 + 4 + 1
_INSTRUCTION_BYTES = 4
_TOKEN = re.compile(r"(?:\s|--[^\n]*)*(\w+|\.\.\.?|[=~<>]=|\S)?")


class LocalVariable(NamedTuple):
    """A local variable and the instructions between which it is active: from `start` to `end`."""

    name: str
    start: int
    end: int


class Upvalue(NamedTuple):
    """An upvalue: a local of the function around (`in_stack`), or that one's upvalue `number`."""

    name: str
    in_stack: bool
    number: int


@dataclass(frozen=True, slots=True)
class LuaFunction:
    """One function of a script as compiled; the main chunk has line 0."""

    line: int
    code: tuple[int, ...]
    lines: tuple[int, ...]
    """Source line of each instruction."""
    variables: tuple[LocalVariable, ...]
    """In the order of their declaration, parameters and a loop's three hidden ones included."""
    upvalues: tuple[Upvalue, ...]
    inner: tuple["LuaFunction", ...]

    @property
    def where(self) -> str:
        """As the Lua compiler names it in its errors."""
        return f"function at line {self.line}" if self.line else "main function"

    def active(self) -> Iterator[int]:
        """For each variable: locals active when it has just been declared, itself included.

        Scopes are nested: an earlier variable is still active when it ends no sooner. (Empty blocks
        in a row, `do local a end do local b end`, make no instruction and count together.)
        """
        ends: list[int] = []
        for variable in self.variables:
            while ends and ends[-1] < variable.end:
                ends.pop()
            ends.append(variable.end)
            yield len(ends)

    @property
    def most_active(self) -> int:
        """Most locals active at once."""
        return max(self.active(), default=0)


def functions_of(source: bytes) -> list[LuaFunction]:
    """Every function of a script that a stock Lua 5.3 compiles, the main chunk first.

    Raises lupa's LuaSyntaxError (a LuaError) where it does not.
    """
    return list(_all(_Reader(_dump()(source)).function()))


@cache
def refusal(source: bytes, chunk_name: str) -> str | None:
    """The error of the vehicle's compiler for a script that a stock one takes; None: it loads.

    Place and words are the vehicle's: `x.lua:673: too many local variables (limit is 100) in main
    function near '='`. `chunk_name` is the name in front of the line. A chunk that a stock Lua
    refuses is not judged.
    """
    try:
        functions = functions_of(source)
    except lua53.LuaError:
        return None
    text = source.decode("utf-8", "replace")
    found = [excess for function in functions for excess in _excesses(text, function)]
    if not found:
        return None
    place, what = min(found)  # a compiler stops at the first one
    match = _TOKEN.match(text, place)
    token = match.group(1) if match else None
    line = text.count("\n", 0, match.start(1) if match and token else len(text)) + 1
    near = f"'{token}'" if token else "<eof>"
    return f"{chunk_name}:{line}: too many {what} near {near}"


def _excesses(text: str, function: LuaFunction) -> Iterator[tuple[int, str]]:
    """Where the name ends that is one too many (the compiler stops at the token after it)."""
    excess = next((n for n, active in enumerate(function.active()) if active > MOST_LOCALS), None)
    if excess is not None:
        what = f"local variables (limit is {MOST_LOCALS}) in {function.where}"
        yield _declaration(text, function, excess), what
    if len(function.upvalues) > MOST_UPVALUES:
        what = f"upvalues (limit is {MOST_UPVALUES}) in {function.where}"
        yield _first_use(text, function, MOST_UPVALUES), what


def _declaration(text: str, function: LuaFunction, number: int) -> int:
    """Where the name of a variable ends in its declaration."""
    started = function.variables[number].start
    last_line = function.lines[started - 1] if started else function.line
    # The hidden variables of a loop are named in brackets: the loop's own first one stands there.
    name = next(v.name for v in function.variables[number:] if not v.name.startswith("("))
    head = r"(?:\blocal\s+(?:function\s+)?|\bfor\s+|\bfunction\b[^(]*\(\s*)(?:\w+\s*,\s*)*"
    declared = re.compile(rf"{head}{re.escape(name)}\b")
    end = _end_of_line(text, last_line)
    found = [match.end() for match in declared.finditer(text, 0, end)]
    if found:
        return found[-1]
    later = declared.search(text, end)  # `local a` and `local b` in a row make one instruction
    return later.end() if later else end


def _first_use(text: str, function: LuaFunction, index: int) -> int:
    """Where the name of an upvalue ends where the function first uses it."""
    line = next(_lines_using(function, index), function.line or 1)
    start, end = _end_of_line(text, line - 1), _end_of_line(text, line)
    name = re.escape(function.upvalues[index].name)
    found = re.compile(rf"(?<![.:\w]){name}\b").search(text, start, end)
    return found.end() if found else end  # a global: its name is not the upvalue's, _ENV


def _lines_using(function: LuaFunction, index: int) -> Iterator[int]:
    """Source lines where the function, or one inside it, uses this upvalue."""
    for code, line in zip(function.code, function.lines, strict=True):
        operation, a, b = code & 0x3F, code >> 6 & 0xFF, code >> 23
        if operation == _CLOSURE:
            inner = function.inner[code >> 14]
            for number, upvalue in enumerate(inner.upvalues):
                if not upvalue.in_stack and upvalue.number == index:
                    yield from _lines_using(inner, number)
        elif (operation in {_GETUPVAL, _GETTABUP, _SETUPVAL} and b == index) or (
            operation == _SETTABUP and a == index
        ):
            yield line


def _end_of_line(text: str, line: int) -> int:
    """Where a line (from 1) ends; 0 for line 0."""
    end = 0
    for _ in range(line):
        end = text.find("\n", end) + 1
        if end == 0:
            return len(text)
    return end


@cache
def _dump() -> Any:
    """Compiles a source (bytes) and returns its bytecode (bytes)."""
    runtime = lua53.LuaRuntime(encoding=None, register_eval=False, register_builtins=False)
    return runtime.eval(b"function(s) return string.dump(assert(load(s, '=?', 't'))) end")


def _all(function: LuaFunction) -> Iterator[LuaFunction]:
    yield function
    for inner in function.inner:
        yield from _all(inner)


class _Reader:
    """Reads the bytecode of `string.dump`: little endian, 32-bit integers and floats."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = _HEADER_BYTES

    def function(self) -> LuaFunction:
        self._text()  # the source's name
        line, _ = self._integers(2)
        self._at += 3  # parameters, "...", size of the stack
        code = self._integers(self._integer())
        for _ in range(self._integer()):
            self._constant()
        places = [self._bytes(2) for _ in range(self._integer())]
        inner = tuple(self.function() for _ in range(self._integer()))
        lines = self._integers(self._integer())
        variables = tuple(
            LocalVariable(self._text(), *self._integers(2)) for _ in range(self._integer())
        )
        names = [self._text() for _ in range(self._integer())]
        upvalues = tuple(
            Upvalue(name, bool(in_stack), number)
            for name, (in_stack, number) in zip(names, places, strict=True)
        )
        return LuaFunction(line, code, lines, variables, upvalues, inner)

    def _constant(self) -> None:
        (kind,) = self._bytes(1)
        if kind in _CONSTANT_BYTES:
            self._at += _CONSTANT_BYTES[kind]
        else:
            self._text()

    def _text(self) -> str:
        (size,) = self._bytes(1)
        if size == 0xFF:  # a long one: its size follows in 8 bytes
            (size,) = unpack_from("<Q", self._data, self._at)
            self._at += 8
        return self._bytes(max(0, size - 1)).decode("utf-8", "replace")

    def _bytes(self, count: int) -> bytes:
        self._at += count
        return self._data[self._at - count : self._at]

    def _integer(self) -> int:
        return self._integers(1)[0]

    def _integers(self, count: int) -> tuple[int, ...]:
        found = unpack_from(f"<{count}I", self._data, self._at)
        self._at += _INSTRUCTION_BYTES * count
        return found
