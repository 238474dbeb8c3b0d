"""Recorded sessions to fit."""

from importlib.resources import as_file, files

import pytest

from phoslab.fitting import fit_session


@pytest.fixture(scope="session")
def green_decay():
    """The sample session that ships with the package."""
    with as_file(files("phoslab.sample_data") / "sessions" / "green-decay") as folder:
        yield folder


@pytest.fixture(scope="session")
def green_fit(green_decay):
    """The automatic fit of the sample session."""
    return fit_session([green_decay], preset="green")
