"""Measure fits of single pixels: how many a second, how many right, and what memory a large session takes.

    python tests/benchmarks/per_pixel.py [PIXELS]

The case: rates 0.132 and 0.009 1/s, amplitudes 0.7 and 0.3 of a peak of 1, 37 samples in 180 s, three channels (1, 0.6,
0.25), sigma 0.002 of the peak; no guess. A fit is right if both rates are within 10 %. The scatter is compared with the
Cramér-Rao bound of that model (rates and amplitudes shared, a free colour).
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from statistics import median

import numpy as np

from phoslab.fitting.pixel_decay import Flag, PixelFits, PixelNoise, PixelProblem, fit_pixels

RATES, AMPLITUDES = np.array([0.132, 0.009]), np.array([0.7, 0.3])
COLOUR, SIGMA = np.array([1.0, 0.6, 0.25]), 0.002
T = np.linspace(0, 180, 37)
RUNS = 5


def bound() -> np.ndarray:
    """(2,) the least standard deviation of log kr."""
    g = np.exp(-T[:, None] * RATES)
    m = g @ AMPLITUDES
    J = np.zeros((3, T.size, 6))
    for c, scale in enumerate(COLOUR):
        J[c, :, :2] = scale * AMPLITUDES * -T[:, None] * RATES * g
        J[c, :, 2:4] = scale * g
    J[1, :, 4], J[2, :, 5] = m, m
    J = J.reshape(-1, 6) / SIGMA
    return np.sqrt(np.diag(np.linalg.inv(J.T @ J))[:2])


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    rng = np.random.default_rng(0)
    curve = (np.exp(-T[:, None] * RATES) @ AMPLITUDES)[:, None] * COLOUR
    y = np.empty((n, *curve.shape), np.float32)
    for some in np.array_split(np.arange(n), max(1, n // 50_000)):
        y[some] = curve + rng.normal(0, SIGMA, (some.size, *curve.shape))
    noise = PixelNoise(np.full(curve.shape, SIGMA**2), np.zeros(curve.shape))
    problem = PixelProblem(
        T, np.zeros(T.size), noise, y[:1000].mean(axis=0, dtype=float), 2, (0.1 / 180, 3 / 5)
    )
    began = time.perf_counter()
    fit_pixels(problem, y[:1])
    print(f"first call (compiled, or read from the cache) {time.perf_counter() - began:.2f} s")
    coarse = fit_pixels(problem, y.mean(axis=0, dtype=float, keepdims=True).astype(np.float32))
    for label, near in (
        ("grid of starts", None),
        ("and the rates of the whole image", coarse.kr_per_s[0].astype(float)),
    ):
        here, times = replace(problem, near_per_s=near), []
        used = []
        for _ in range(RUNS):
            began, cpu = time.perf_counter(), time.process_time()
            fits = fit_pixels(here, y)
            times.append(time.perf_counter() - began)
            used.append(time.process_time() - cpu)
        print(f"[{label}]")
        print(
            f"{n / median(times):,.0f} fits/s (median of {RUNS}; {n / max(times):,.0f} to {n / min(times):,.0f}); ",
            end="",
        )
        print(f"{n / median(used):,.0f} a second of one processor")
        say(fits)


def say(fits: PixelFits) -> None:
    """Print how good the fits are."""
    off = np.abs(fits.kr_per_s / RATES - 1)
    print(f"right: {(off < 0.1).all(axis=1).mean():.4%} of {len(off):,}; worst rate off by {off.max():.2%}")
    print(f"flagged: { {f.name: int((fits.flags & f > 0).sum()) for f in Flag} }")
    scatter = np.log(fits.kr_per_s.astype(float)).std(axis=0)
    print(f"scatter over the Cramér-Rao bound: {scatter / bound()}")
    z = (fits.kr_per_s - RATES) / fits.kr_error
    za = (fits.amplitude - AMPLITUDES) / fits.amplitude_error
    print(f"deviations over their standard errors: rates {z.std(axis=0)}, amplitudes {za.std(axis=0)}")


if __name__ == "__main__":
    main()
