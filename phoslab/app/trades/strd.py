"""Problems of the NIST Statistical Reference Datasets (StRD, nonlinear regression) that separate.

Data and certified values are those of the StRD; that they are typed rightly is held by the certified sum of squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.varpro import Basis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """A separable problem: nonlinear θ, all of them logarithms of rates, and linear x.

    Args:
        x, y: the data.
        shape: (x, rate) -> a basis function and its derivative by log rate.
        constant: whether a constant stands first in the basis.
        rates, linear: certified values, in the order of the basis.
        starts: of the rates.
        linear_starts: of the linear parameters, for those who search them.
        rate_sd, linear_sd: certified standard deviations.
        sum_of_squares: certified.
    """

    x: Array
    y: Array
    shape: Callable[[Array, float], tuple[Array, Array]]
    constant: bool
    rates: Array
    linear: Array
    rate_sd: Array
    linear_sd: Array
    starts: tuple[tuple[float, ...], ...]
    linear_starts: tuple[tuple[float, ...], ...]
    sum_of_squares: float

    @property
    def basis(self) -> Basis:
        """Φ and dΦ/dθ for `varpro`, unweighted."""

        def evaluate(theta: Array) -> tuple[Array, Array]:
            first = int(self.constant)
            phi = np.ones((1, self.x.size, theta.size + first), theta.dtype)
            derivative = np.zeros((theta.size, *phi.shape), theta.dtype)
            for i, rate in enumerate(np.exp(theta)):
                phi[0, :, i + first], derivative[i, 0, :, i + first] = self.shape(self.x, rate)
            return phi, derivative

        return evaluate

    def matched(self, rates: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return where the certified rates stand among `rates`, and their linear parameters beside the constant."""
        order = np.argsort(rates)[np.argsort(np.argsort(self.rates))]
        first = int(self.constant)
        return order, np.concatenate([np.arange(first), order + first])

    def digits(self, rates: Array, linear: Array) -> float:
        """Return the correct digits of the worst parameter, whatever the order of the states."""
        order, columns = self.matched(rates)
        return min(digits(rates[order], self.rates), digits(linear[columns], self.linear))

    def certified(self, rates: Array, linear: Array) -> bool:
        """Whether every parameter, rounded as the certificate is, is the certificate's to its last digit."""
        order, columns = self.matched(rates)
        pairs = [(rates[order], self.rates), (linear[columns], self.linear)]
        return all(
            f"{v:.10e}" == f"{c:.10e}" for value, whole in pairs for v, c in zip(value, whole, strict=True)
        )


def _decay(x: Array, k: float) -> tuple[Array, Array]:
    return np.exp(-k * x), -k * x * np.exp(-k * x)


def _growth(x: Array, k: float) -> tuple[Array, Array]:
    return -np.expm1(-k * x), k * x * np.exp(-k * x)


def _power(x: Array, k: float) -> tuple[Array, Array]:
    return x**k, k * np.log(x) * x**k


def _lanczos(digits: int) -> tuple[Array, Array]:
    """x and y: the sum that Lanczos gave, written with so many digits."""
    x = np.arange(24) * 5 / 100  # the nearest to the decimal; 3 * 0.05 is not
    y = 0.0951 * np.exp(-x) + 0.8607 * np.exp(-3 * x) + 1.5576 * np.exp(-5 * x)
    return x, np.array([float(f"{v:.{digits - 1}e}") for v in y])


_LANCZOS_STARTS = ((0.3, 5.5, 7.6), (0.7, 4.2, 6.3))
_LANCZOS_LINEAR_STARTS = ((1.2, 5.6, 6.5), (0.5, 3.6, 4.0))

# fmt: off
_LANCZOS3_Y = np.array([
    2.5134, 2.0443, 1.6684, 1.3664, 1.1232, 0.9269, 0.7679, 0.6389, 0.5338, 0.4479, 0.3776, 0.3197,
    0.2720, 0.2325, 0.1997, 0.1723, 0.1493, 0.1301, 0.1138, 0.1000, 0.0883, 0.0783, 0.0698, 0.0624,
])
_MGH17_Y = np.array([
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751, 0.718, 0.685, 0.658, 0.628, 0.603,
    0.580, 0.558, 0.538, 0.522, 0.506, 0.490, 0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411,
    0.406,
])
# fmt: on

LANCZOS1 = Problem(
    *_lanczos(13), _decay, False,
    rates=np.array([1.0000000001, 3.0000000002, 5.0000000001]),
    linear=np.array([9.5100000027e-02, 8.6070000013e-01, 1.5575999998]),
    rate_sd=np.array([2.7473038179e-10, 3.3308253069e-10, 1.1057500538e-10]),
    linear_sd=np.array([5.3347304234e-11, 1.3576062225e-10, 1.8815731448e-10]),
    starts=_LANCZOS_STARTS, linear_starts=_LANCZOS_LINEAR_STARTS, sum_of_squares=1.4307867721e-25,
)  # fmt: skip
LANCZOS2 = Problem(
    *_lanczos(6), _decay, False,
    rates=np.array([1.0057332849, 3.0078283915, 5.0028798100]),
    linear=np.array([9.6251029939e-02, 8.6424689056e-01, 1.5529016879]),
    rate_sd=np.array([3.3989646176e-03, 4.1707005856e-03, 1.3958787284e-03]),
    linear_sd=np.array([6.6770575477e-04, 1.7185846685e-03, 2.3744381417e-03]),
    starts=_LANCZOS_STARTS, linear_starts=_LANCZOS_LINEAR_STARTS, sum_of_squares=2.2299428125e-11,
)  # fmt: skip
LANCZOS3 = Problem(
    _lanczos(5)[0], _LANCZOS3_Y, _decay, False,
    rates=np.array([9.5498101505e-01, 2.9515951832, 4.9863565084]),
    linear=np.array([8.6816414977e-02, 8.4400777463e-01, 1.5825685901]),
    rate_sd=np.array([9.7041624475e-02, 1.0766312506e-01, 3.4436403035e-02]),
    linear_sd=np.array([1.7197908859e-02, 4.1488663282e-02, 5.8371576281e-02]),
    starts=_LANCZOS_STARTS, linear_starts=_LANCZOS_LINEAR_STARTS, sum_of_squares=1.6117193594e-08,
)  # fmt: skip
BOXBOD = Problem(
    np.array([1.0, 2, 3, 5, 7, 10]), np.array([109.0, 149, 149, 191, 213, 224]), _growth, False,
    rates=np.array([5.4723748542e-01]), linear=np.array([2.1380940889e02]),
    rate_sd=np.array([1.0455993237e-01]), linear_sd=np.array([1.2354515176e01]),
    starts=((1.0,), (0.75,)), linear_starts=((1.0,), (100.0,)), sum_of_squares=1.1680088766e03,
)  # fmt: skip
MGH17 = Problem(
    np.linspace(0.0, 320.0, 33), _MGH17_Y, _decay, True,
    rates=np.array([1.2867534640e-02, 2.2122699662e-02]),
    linear=np.array([3.7541005211e-01, 1.9358469127, -1.4646871366]),
    rate_sd=np.array([4.4861358114e-04, 8.9471996575e-04]),
    linear_sd=np.array([2.0723153551e-03, 2.2031669222e-01, 2.2175707739e-01]),
    starts=((1.0, 2.0), (0.01, 0.02)), linear_starts=((50.0, 150.0, -100.0), (0.5, 1.5, -1.0)),
    sum_of_squares=5.4648946975e-05,
)  # fmt: skip
DANWOOD = Problem(
    np.array([1.309, 1.471, 1.490, 1.565, 1.611, 1.680]), np.array([2.138, 3.421, 3.597, 4.340, 4.882, 5.660]),
    _power, False,
    rates=np.array([3.8604055871]), linear=np.array([7.6886226176e-01]),
    rate_sd=np.array([5.1726610913e-02]), linear_sd=np.array([1.8281973860e-02]),
    starts=((5.0,), (4.0,)), linear_starts=((1.0,), (0.7,)), sum_of_squares=4.3173084083e-03,
)  # fmt: skip

PROBLEMS = {
    "Lanczos1": LANCZOS1,
    "Lanczos2": LANCZOS2,
    "Lanczos3": LANCZOS3,
    "BoxBOD": BOXBOD,
    "MGH17": MGH17,
    "DanWood": DANWOOD,
}


def digits(value: Array, certified: Array) -> float:
    """Return the correct significant digits of the worst parameter (the log relative error of the StRD)."""
    return float(np.min(-np.log10(np.abs(value - certified) / np.abs(certified) + 1e-17)))
