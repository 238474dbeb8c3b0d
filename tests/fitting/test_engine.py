"""Fits on the workers of a dask scheduler: the same numbers as here, whatever happens to a worker."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from phoslab.errors import PhoslabError
from phoslab.fitting.engine import check_address, here, on_scheduler
from phoslab.fitting.pixel_decay import PixelNoise, PixelProblem

distributed = pytest.importorskip("distributed", reason="pip install phoslab[campaign]")

T_S = np.linspace(0.5, 180.5, 19)
KR, AMPLITUDE = np.array([0.132, 0.009]), np.array([0.7, 0.3])
LIGHT = (np.exp(-np.outer(T_S, KR)) @ AMPLITUDE)[:, None] * [1.0, 0.6, 0.25]


@pytest.fixture(scope="module")
def problem() -> PixelProblem:
    noise = PixelNoise(floor=np.full(LIGHT.shape, 0.002**2), gain=np.zeros(LIGHT.shape), repeatability=0.0)
    return PixelProblem(
        t_s=T_S,
        exposure_s=np.zeros(T_S.size),
        noise=noise,
        typical=LIGHT,
        n_states=2,
        limits_per_s=(1e-3, 1.0),
        near_per_s=KR,
    )


@pytest.fixture(scope="module")
def strips() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [(LIGHT + rng.normal(0, 0.002, (500, *LIGHT.shape))).astype(np.float32) for _ in range(12)]


@pytest.fixture
def cluster() -> Iterator[distributed.LocalCluster]:
    """A scheduler with two workers, each a process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as made:
        yield made


def test_a_worker_that_is_killed_midway_changes_no_number(problem, strips, cluster):
    killed = []

    def with_a_death() -> Iterator[np.ndarray]:
        for k, strip in enumerate(strips):
            if k == 5:
                with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
                    pids = client.run(os.getpid)
                killed.append(next(iter(pids.values())))
                os.kill(killed[0], signal.SIGKILL)
            yield strip

    with on_scheduler(cluster.scheduler_address) as fits:
        found = list(fits(problem, with_a_death()))
    assert killed
    for there, local in zip(found, here(problem, strips), strict=True):
        for name, values in vars(local).items():
            assert np.array_equal(getattr(there, name), values, equal_nan=True), name


def test_strips_are_asked_for_as_they_are_needed(problem, strips, cluster):
    """Two for each thread are on their way, and no more lie in any memory."""
    asked = 0

    def counted() -> Iterator[np.ndarray]:
        nonlocal asked
        for strip in strips:
            asked += 1
            yield strip

    with on_scheduler(cluster.scheduler_address) as fits:
        next(fits(problem, counted()))
    assert asked == 2 * 2 + 1


@pytest.mark.parametrize(
    ("address", "problem_named"),
    [
        ("tcp://192.0.2.7:8786", "unencrypted"),
        ("lab.example:8786", "unencrypted"),
        ("http://127.0.0.1:8786", "no address"),
        ("tcp://127.0.0.1", "no address"),
        ("tcp://127.0.0.1:none", "no address"),
        ("", "no address"),
    ],
)
def test_what_is_no_safe_address_is_refused_before_anything_is_opened(address, problem_named):
    with pytest.raises(PhoslabError, match=problem_named):
        check_address(address)


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:8786", "localhost:8786", "tcp://[::1]:8786", "tls://far:1"]
)
def test_this_machine_and_what_is_encrypted_are_taken(address):
    check_address(address)


def test_a_scheduler_without_workers_is_said():
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(PhoslabError, match="has no workers"),
        on_scheduler(cluster.scheduler_address),
    ):
        pass


def test_nobody_at_the_address_is_said(monkeypatch):
    monkeypatch.setattr("phoslab.fitting.engine._PATIENCE_S", 0.5)
    with pytest.raises(PhoslabError, match="does not answer"), on_scheduler("tcp://127.0.0.1:9"):
        pass
