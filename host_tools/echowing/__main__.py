"""`python -m echowing` is `echowing`."""

import sys

from echowing.cli import main

sys.exit(main())
