"""What all tests share."""

import os

# As the command line does, before anything imports NumPy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

# Speed is not tested here (a deadline would), and a run must be repeatable.
settings.register_profile("phoslab", deadline=None, derandomize=True)
settings.load_profile("phoslab")
