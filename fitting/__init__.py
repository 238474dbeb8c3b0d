"""From recorded sessions to materials, offline."""

from phoslab.fitting.result import FitResult as FitResult
from phoslab.fitting.result import fit_session as fit_session
