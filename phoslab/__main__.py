"""`python -m phoslab` is the command `phoslab`."""

import sys

from phoslab.app.cli import main

sys.exit(main())
