"""What all tests share."""

from hypothesis import settings

# Speed is not tested here (a deadline would), and a run must be repeatable.
settings.register_profile("phoslab", deadline=None, derandomize=True)
settings.load_profile("phoslab")
