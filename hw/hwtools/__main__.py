"""`python -m hwtools`: make everything in `hw/` that is made."""

import sys
import tempfile
from pathlib import Path

from echowing.errors import EchowingError
from hwtools import made
from hwtools.facts import HardwareError


def main() -> int:
    """Make it all, telling each file; 2 and a sentence when a source or a program is at fault."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            made.make_everything(Path(folder), lambda name: print(f"hw/{name}"))
    except (HardwareError, EchowingError) as error:
        print(f"make hw: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
