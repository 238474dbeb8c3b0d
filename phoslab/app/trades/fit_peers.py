"""Other fits of exponentials, run beside ours as their own users would: default tolerances, a start that they need.

phoslab needs none of them. Those that are installed (`pip install phoslab[peers]`) are measured, the others named.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades import strd
from phoslab.fitting.decay_data import DecayData

Array = NDArray[np.float64]

_MOST_CALLS = 20_000


@dataclass(frozen=True)
class Peer:
    """Another fit.

    Args:
        name: as its users know it.
        module: that must be there.
        rates: (decay, start of two rates) -> the two rates, fast to slow; raises where it fails.
        problem: (StRD problem, which start) -> rates and linear parameters in the order of the problem; raises where
            it fails. None: it cannot state these problems.
        states: whether it can state a problem, by its name.
        many: fits several decays in one call, where it can: -> (n, 2).
        about: what is special, for the page.
    """

    name: str
    module: str
    rates: Callable[[DecayData, tuple[float, float]], Array]
    problem: Callable[[strd.Problem, int], tuple[Array, Array]] | None
    states: Callable[[str], bool] = lambda name: True
    many: Callable[[Sequence[DecayData], tuple[float, float]], Array] | None = None
    about: str = ""

    @property
    def installed(self) -> bool:
        """Whether it is there."""
        return importlib.util.find_spec(self.module) is not None


def rates_or_nan(name: str, start: tuple[float, float], data: DecayData) -> Array:
    """Return (2,) the rates in 1/s, fast to slow, of the peer of that name; NaN where it gives up."""
    peer = next(p for p in PEERS if p.name == name)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = peer.rates(data, start)
        except (ArithmeticError, RuntimeError, TypeError, ValueError):
            return np.full(2, np.nan)
    return np.sort(np.asarray(found, float))[::-1]


def digits(peer: Peer, name: str, start: int) -> float | str | None:
    """Return the digits of the worst parameter of a StRD problem; "fails"; None where it cannot be stated."""
    if peer.problem is None or not peer.states(name):
        return None
    p = strd.PROBLEMS[name]
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            rates, linear = peer.problem(p, start)
        except (ArithmeticError, RuntimeError, TypeError, ValueError):
            return "fails"
    if not (np.isfinite(rates).all() and np.isfinite(linear).all()):
        return "fails"
    return p.digits(rates, linear)


def _model(p: strd.Problem) -> Callable[..., Array]:
    n = len(p.rates)

    def model(_: Array, *parameters: float) -> Array:
        signal: Array = p.basis(np.log(np.abs(parameters[:n])))[0][0] @ np.array(parameters[n:])
        return signal

    return model


def _decay(t_s: Array, k1: float, k2: float, *a: float) -> Array:
    """(3 n,) the two states in three channels, one channel after the other."""
    signal: Array = (np.exp(-np.outer(t_s, (k1, k2))) @ np.reshape(a, (2, 3))).T.ravel()
    return signal


def _curve_fit_rates(data: DecayData, start: tuple[float, float]) -> Array:
    from scipy.optimize import curve_fit

    found, _ = curve_fit(
        _decay,
        data.t_s,
        data.signal.T.ravel(),
        [*start, *[1.0] * 6],
        data.sigma.T.ravel(),
        maxfev=_MOST_CALLS,
    )
    return np.asarray(found[:2])


def _curve_fit_problem(p: strd.Problem, start: int) -> tuple[Array, Array]:
    from scipy.optimize import curve_fit

    n = len(p.rates)
    found, _ = curve_fit(_model(p), p.x, p.y, [*p.starts[start], *p.linear_starts[start]], maxfev=_MOST_CALLS)
    return np.abs(found[:n]), found[n:]


def _lmfit(residual: Callable[[Array], Array], start: list[float]) -> Array:
    import lmfit

    parameters = lmfit.Parameters()
    for k, value in enumerate(start):
        parameters.add(f"p{k}", value=value)
    found = lmfit.minimize(
        lambda p: residual(np.array([v.value for v in p.values()])), parameters, max_nfev=_MOST_CALLS
    )
    return np.array([v.value for v in found.params.values()])


def _lmfit_rates(data: DecayData, start: tuple[float, float]) -> Array:
    y, sigma = data.signal.T.ravel(), data.sigma.T.ravel()
    return _lmfit(lambda v: (y - _decay(data.t_s, *v)) / sigma, [*start, *[1.0] * 6])[:2]


def _lmfit_problem(p: strd.Problem, start: int) -> tuple[Array, Array]:
    model, n = _model(p), len(p.rates)
    found = _lmfit(lambda v: p.y - model(p.x, *v), [*p.starts[start], *p.linear_starts[start]])
    return np.abs(found[:n]), found[n:]


def _glotaran(t_s: Array, y: Array, start: tuple[float, ...], *, constant: bool = False) -> tuple[Array, Any]:
    """Fit rates and, by variable projection, amplitudes; y is (n, n_channels)."""
    import xarray as xr
    from glotaran.builtin.megacomplexes.baseline import BaselineMegacomplex
    from glotaran.builtin.megacomplexes.decay import DecayParallelMegacomplex
    from glotaran.model import Model
    from glotaran.optimization.optimize import optimize
    from glotaran.parameter import Parameters
    from glotaran.project.scheme import Scheme

    states = [f"s{k + 1}" for k in range(len(start))]
    labels = [f"rates.{k + 1}" for k in range(len(start))]
    parts = {"decay": {"type": "decay-parallel", "compartments": states, "rates": labels}}
    if constant:
        parts["constant"] = {"type": "baseline", "dimension": "time"}
    kinds = [DecayParallelMegacomplex, BaselineMegacomplex]
    model = Model.create_class_from_megacomplexes(kinds)(
        megacomplex=parts, dataset={"data": {"megacomplex": list(parts)}}
    )
    parameters = Parameters.from_dict({"rates": [*start, {"non-negative": True}]})
    axes = [("time", t_s), ("spectral", np.arange(y.shape[1], dtype=float))]
    data = {"data": xr.DataArray(y, coords=axes).to_dataset(name="data")}
    scheme = Scheme(model, parameters, data, add_svd=False, maximum_number_function_evaluations=500)
    result = optimize(scheme, verbose=False, raise_exception=True)
    rates = np.array([result.optimized_parameters.get(label).value for label in labels])
    return rates, result.data["data"]


def _glotaran_rates(data: DecayData, start: tuple[float, float]) -> Array:
    return _glotaran(data.t_s, data.signal, start)[0]


def _glotaran_problem(p: strd.Problem, start: int) -> tuple[Array, Array]:
    rates, result = _glotaran(p.x, p.y[:, None], p.starts[start], constant=p.constant)
    labels = [*(["data_baseline"] if p.constant else []), *(f"s{k + 1}" for k in range(len(rates)))]
    linear = np.array([float(result.clp.sel(clp_label=label).values[0]) for label in labels])
    linear[int(p.constant) :] /= len(rates)  # its states share an initial concentration of 1
    return rates, linear


def _flimlib_many(decays: Sequence[DecayData], start: tuple[float, float]) -> Array:
    import flimlib

    t_s = decays[0].t_s
    guess = np.array([0.0, 1.0, 1 / start[0], 1.0, 1 / start[1]], np.float32)
    found = flimlib.GCI_marquardt_fitting_engine(
        float(t_s[1] - t_s[0]),
        np.array([d.signal[:, 0] for d in decays], np.float32),
        np.tile(guess, (len(decays), 1)),
        noise_type="NOISE_CONST",
        sig=float(decays[0].sigma[0, 0]),
        fitfunc=flimlib.GCI_multiexp_tau,
    )
    lifetimes: Array = np.asarray(found.param[:, [2, 4]], float)
    return 1 / lifetimes


def _flimlib_rates(data: DecayData, start: tuple[float, float]) -> Array:
    return np.asarray(_flimlib_many([data], start)[0])


PEERS = (
    Peer("curve_fit", "scipy", _curve_fit_rates, _curve_fit_problem),
    Peer("lmfit", "lmfit", _lmfit_rates, _lmfit_problem),
    Peer(
        "pyglotaran",
        "glotaran",
        _glotaran_rates,
        _glotaran_problem,
        states=lambda name: name.startswith("Lanczos") or name == "MGH17",
        about="by variable projection; sums of exponentials and a constant only",
    ),
    Peer(
        "flimlib",
        "flimlib",
        _flimlib_rates,
        None,
        many=_flimlib_many,
        about="float32, one channel with an offset",
    ),
)
