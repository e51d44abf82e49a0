"""Draws the gimbal on its search: the points of the figure 8, and its direction."""

from collections.abc import Mapping, Sequence

from rich.text import Text

from echowing.rig.search import Aim, aims, parameter_defaults, scan_pulses_us

COLUMNS, ROWS = 34, 7
MARGIN = 2  # half a label stands out at either side
# Pulses are whole microseconds on the wire: nearer than this is the point itself.
SAME_US = 0.5

_POINT, _HERE, _ELSEWHERE = "cyan", "bold black on green", "bold yellow"


def completed(parameters: Mapping[str, float]) -> dict[str, float]:
    """The board's parameters as far as they are known, defaults for the others."""
    return {**parameter_defaults(), **parameters}


def direction(parameters: Mapping[str, float], pan_us: float, tilt_us: float) -> Aim:
    """The direction of these pulses, degrees right and up of straight ahead."""
    return _aims(completed(parameters), [(pan_us, tilt_us)])[0]


def points_at(parameters: Mapping[str, float], pan_us: float, tilt_us: float) -> tuple[int, ...]:
    """Numbers (from 1) of the search's points with these pulses; some points coincide."""
    return tuple(
        number
        for number, (pan, tilt) in enumerate(scan_pulses_us(completed(parameters)), start=1)
        if abs(pan - pan_us) < SAME_US and abs(tilt - tilt_us) < SAME_US
    )


def draw(
    parameters: Mapping[str, float], pan_us: float | None = None, tilt_us: float | None = None
) -> Text:
    """The search as seen from behind the gimbal: each point by its numbers.

    The current one is highlighted, in brackets. Between the points the gimbal is a plus sign, at
    the edge if it points beyond the search.
    """
    values = completed(parameters)
    pulses = scan_pulses_us(values)
    looked = _aims(values, pulses)
    grid = _Grid(looked)
    for pulse, aim in dict(zip(pulses, looked, strict=True)).items():
        grid.put("·".join(map(str, points_at(values, *pulse))), aim, _POINT)
    if pan_us is not None and tilt_us is not None:
        here = points_at(values, pan_us, tilt_us)
        aim = _aims(values, [(pan_us, tilt_us)])[0]
        if here:
            grid.put(f"[{'·'.join(map(str, here))}]", aim, _HERE)
        else:
            grid.put("+", aim, _ELSEWHERE)
    return grid.text()


def _aims(values: Mapping[str, float], pulses: Sequence[tuple[float, float]]) -> list[Aim]:
    defaults = parameter_defaults()
    # A scale of 0 (fixed mount) has no degrees: drawn as with the usual servo.
    scales = [values[name] or defaults[name] for name in ("PAN_US_DEG", "TILT_US_DEG")]
    return aims(pulses, (values["PAN_MIDDLE"], values["TILT_MIDDLE"]), (scales[0], scales[1]))


class _Grid:
    """Characters with their styles; the points' extremes lie on its edges, but for the margin."""

    def __init__(self, looked: Sequence[Aim]) -> None:
        self._right = _extremes([aim.right_deg for aim in looked])
        self._up = _extremes([aim.up_deg for aim in looked])
        self._cells = [[(" ", "")] * COLUMNS for _ in range(ROWS)]

    def put(self, label: str, aim: Aim, style: str) -> None:
        row = ROWS - 1 - _place(aim.up_deg, self._up, ROWS)
        middle = MARGIN + _place(aim.right_deg, self._right, COLUMNS - 2 * MARGIN)
        first = min(max(middle - len(label) // 2, 0), COLUMNS - len(label))
        for column, character in enumerate(label, start=first):
            self._cells[row][column] = (character, style)

    def text(self) -> Text:
        lines = [Text.assemble(*line) for line in self._cells]
        return Text("\n").join(lines)


def _extremes(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def _place(value: float, extremes: tuple[float, float], cells: int) -> int:
    least, most = extremes
    share = (value - least) / (most - least) if most > least else 0.5
    return round(min(max(share, 0.0), 1.0) * (cells - 1))
