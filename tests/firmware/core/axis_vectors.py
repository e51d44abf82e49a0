"""Write the axis' test vectors as C++: axis_vectors.py AXIS.TOML AXIS_VECTORS.H."""

import sys
import tomllib
from pathlib import Path

FIELDS = (
    *("azimuth_deg", "elevation_deg", "roll_deg", "pitch_deg", "yaw_deg"),
    *("pan_deg", "tilt_deg"),
)


def main(table: Path, header: Path) -> None:
    """One row of the table is one of the array."""
    rows = tomllib.loads(table.read_text(encoding="utf-8"))["axis"]
    lines = [f"    {{{', '.join(str(row[field]) for field in FIELDS)}}}," for row in rows]
    text = [
        "#pragma once",
        "struct AxisVector {",
        *(f"  double {field};" for field in FIELDS),
        "};",
        "constexpr AxisVector kAxisVectors[] = {",
        *lines,
        "};",
    ]
    header.parent.mkdir(exist_ok=True)
    header.write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
