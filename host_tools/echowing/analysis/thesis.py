"""What the thesis printed: ground tests (4.2) and flights (Tables 7 to 11), to stand beside ours.

The values are as printed, the inconsistent ones too; `FOOTNOTES` says where they do not fit.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ErrorFigures:
    """One group of three columns of Table 10, metres."""

    mean_m: float
    sigma_m: float
    drms_m: float


@dataclass(frozen=True)
class ThesisFigures:
    """One flight of the thesis. Metres; None: not printed there. notes: keys of FOOTNOTES."""

    title: str
    mean_separation_m: float | None = None
    mean_abs_error_m: float | None = None
    rmsd_m: float | None = None
    std_m: float | None = None
    forward: ErrorFigures | None = None
    right: ErrorFigures | None = None
    position: ErrorFigures | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """One line of Table 11, metres and per cent."""

    name: str
    gray_m: float
    sonar_m: float
    reduced_percent: float


FOOTNOTES = {
    "a": (
        "Table 8's RMSD of 2.55 m does not follow from its own mean (6.51 m for a wanted 3 m) "
        "and deviation (2.51 m), which give 4.31 m."
    ),
    "b": (
        "Table 10's DRMS is smaller than its own sigma in places (right error, test 2: 0.62 m "
        "against 0.85 m), which sqrt(mean(e^2)) cannot be."
    ),
    "c": (
        "Table 11 sets Gray's 1.77 m (DRMS) beside the sonar flight's RMSD, and Gray's 3.08 m "
        "(mean distance to the slot) beside its mean separation error: different statistics."
    ),
    "d": "Table 9's mean error of 0.896 m is that of the absolute separation error.",
}

TABLE_7 = ThesisFigures("Table 7", mean_separation_m=7.67, rmsd_m=4.76, std_m=3.02)
TABLE_8 = ThesisFigures("Table 8", mean_separation_m=6.51, rmsd_m=2.55, std_m=2.51, notes=("a",))
TABLE_9 = ThesisFigures(
    "Table 9",
    mean_separation_m=3.08,
    mean_abs_error_m=0.896,
    rmsd_m=1.11,
    std_m=1.11,
    notes=("d",),
)


def _gray(test: int, *values: float) -> ThesisFigures:
    forward, right, position = (ErrorFigures(*values[i : i + 3]) for i in (0, 3, 6))
    title = f"Table 10, test {test}"
    return ThesisFigures(title, forward=forward, right=right, position=position, notes=("b",))


# Forward, right and position error: mean, sigma, DRMS each.
TABLE_10 = (
    _gray(1, -1.76, 1.58, 1.94, 0.60, 1.62, 1.41, 3.45, 1.11, 2.97),
    _gray(2, -1.80, 1.18, 1.21, 0.70, 0.85, 0.62, 3.08, 0.63, 1.77),
    _gray(3, -1.00, 1.33, 1.34, 0.49, 1.29, 1.11, 2.85, 1.32, 2.53),
    _gray(4, -2.92, 1.92, 2.64, -0.81, 2.25, 1.80, 5.08, 2.16, 4.17),
    _gray(5, -2.54, 1.56, 2.44, -0.01, 1.18, 0.96, 3.94, 1.68, 3.51),
    _gray(6, -2.44, 1.78, 2.21, -0.67, 1.97, 1.52, 4.47, 2.29, 3.67),
)
GRAY_BEST = TABLE_10[1]  # the one the thesis compares itself with (4.4)

TABLE_11 = (
    Comparison("RMSD", 1.77, 1.11, 37.3),
    Comparison("average position error", 3.08, 0.896, 70.9),
)

# Gray's flight as the thesis sets it beside its own.
GRAY_IN_TABLE_11 = ThesisFigures(
    "Table 11, Gray",
    mean_abs_error_m=TABLE_11[1].gray_m,
    rmsd_m=TABLE_11[0].gray_m,
    notes=("c",),
)

# Which printed figures stand beside which scenario.
BESIDE = {
    "gray": (GRAY_IN_TABLE_11, GRAY_BEST),
    "thesis": (TABLE_9,),
    "thesis-4m": (TABLE_7,),
    "thesis-initial": (TABLE_8,),
    "echowing": (TABLE_9,),
}


@dataclass(frozen=True)
class SeenTo:
    """How far a sonar detects an X8, metres: without foil, and with 50 square inches of it."""

    stock_m: float
    foil_m: float


# Table 5. The MB1260 is the MB1202's sister with an analog output.
TABLE_5 = {"MB1020": SeenTo(1.6, 2.1), "MB1202": SeenTo(3.2, 4.6)}

THESIS_GAIN_PERCENT = 43.0  # 3.4.2, "increased by 43 %"; how it was computed is not told


@dataclass(frozen=True)
class Band:
    """A row of Table 6: ranges from `from_m` (included) to `to_m`, and the change of speed."""

    name: str
    from_m: float
    to_m: float
    step_mps: float


# Table 6. Beyond 4.5 m the gimbal searches and the speed stays.
TABLE_6 = (
    Band("attract, big step", 3.25, 4.5, 1.0),
    Band("attract, small step", 3.05, 3.25, 0.5),
    Band("monitor", 2.95, 3.05, 0.0),
    Band("repel, small step", 2.75, 2.95, -0.5),
    Band("repel, big step", 0.0, 2.75, -1.0),
)

# Figure 28: average distance in metres, new trim airspeed in m/s after it. The 6.08 m was fed by
# hand (it lies beyond the detection limit); at 3.636 m the airspeed was at its maximum.
FIGURE_28 = (
    (3.080, 2.5),
    (2.622, 1.5),
    (2.916, 1.0),
    (3.104, 1.5),
    (3.090, 2.0),
    (3.102, 2.5),
    (2.450, 1.5),
    (3.591, 2.5),
    (3.916, 3.5),
    (6.080, 4.5),
    (3.636, 4.5),
    (2.370, 3.5),
    (3.234, 4.0),
    (0.790, 3.0),
    (3.488, 4.0),
)
