"""From recorded sessions to materials, offline."""

from phoslab.fitting.result import FitResult as FitResult
from phoslab.fitting.session_fit import fit_session as fit_session
