"""Runs the command `imucal` as `python -m imucal.cli`."""

import sys

from imucal.cli.app import main

sys.exit(main())
