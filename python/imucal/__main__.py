"""`python -m imucal` is the command `imucal`."""

import sys

from imucal.cli import main

sys.exit(main())
