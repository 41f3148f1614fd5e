"""`python -m imucal.cli` is `imucal`."""

import sys

from imucal.cli.app import main

sys.exit(main())
