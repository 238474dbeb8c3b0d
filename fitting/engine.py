"""Where pixels are fitted: on this machine, or by the workers of a dask scheduler that runs already.

    with on_scheduler("tcp://127.0.0.1:8786") as fits:
        for found in fits(problem, strips):
            ...

Both give the same numbers, since each pixel is fitted by itself. Values travel with their task, so that workers need no
file of ours, and a task whose worker dies is begun again elsewhere. Only a few strips are on their way at a time: that
bounds the memory of all.
"""

from __future__ import annotations

import ipaddress
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

import phoslab
from phoslab.errors import PhoslabError
from phoslab.fitting.pixel_decay import PixelFits, PixelProblem, fit_pixels

if TYPE_CHECKING:
    from distributed import Client, Future

Pixels = NDArray[np.float32]
Fits = Callable[[PixelProblem, Iterable[Pixels]], Iterator[PixelFits]]
"""Fits strips of pixels (n_pixels, n_frames, n_channels), in their order."""

_PATIENCE_S = 10.0
_AHEAD = 2
"""Strips on their way for each thread of the workers: one that is fitted and one that waits."""


def here(problem: PixelProblem, strips: Iterable[Pixels]) -> Iterator[PixelFits]:
    """Fit on this machine, on all its processors."""
    return (fit_pixels(problem, y) for y in strips)


@contextmanager
def on_scheduler(address: str) -> Iterator[Fits]:
    """Fit on the workers of the scheduler at `address`; they need phoslab of this version and no common disk.

    Raises:
        PhoslabError: the address is not of this machine and not encrypted; nothing answers there; it has no workers, or
            some of another version; or a task has lost so many workers that the scheduler gives it up.
    """
    check_address(address)
    try:
        from distributed import Client
    except ImportError:
        raise PhoslabError(
            "needs dask's `distributed`, which is not installed",
            field="--scheduler",
            remedy="pip install 'phoslab[campaign]'",
        ) from None
    try:
        client = Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise PhoslabError(
            f"{address} does not answer as a scheduler within {_PATIENCE_S:g} s ({str(error) or type(error).__name__})",
            field="--scheduler",
            remedy="Start one with `dask scheduler --host 127.0.0.1` and workers with `dask worker ADDRESS`.",
        ) from error
    with client:
        yield partial(_remote, client, _threads(client, address))


def check_address(address: str) -> None:
    """Refuse an address that others could listen to, or that would let others run code on this machine.

    >>> check_address("tcp://127.0.0.1:8786")
    >>> check_address("tls://lab.example:8786")
    """
    at = urlsplit(address if "://" in address else f"tcp://{address}")
    try:
        port = at.port
    except ValueError:
        port = None
    if at.scheme not in ("tcp", "tls") or not at.hostname or port is None:
        raise PhoslabError(
            f"{address!r} is no address of a dask scheduler",
            field="--scheduler",
            remedy="Use tcp://127.0.0.1:8786 (this machine) or tls://host:8786.",
        )
    if at.scheme == "tcp" and not _is_this_machine(at.hostname):
        raise PhoslabError(
            f"{address!r} goes over the network unencrypted: whoever reaches it runs code on all its machines",
            field="--scheduler",
            remedy="Use tls://, with certificates set as dask's documentation says (distributed.comm.tls), or a tunnel "
            "to 127.0.0.1.",
        )


def _is_this_machine(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _threads(client: Client, address: str) -> int:
    """The workers' threads, all together."""
    versions = client.run(_version)
    other = {v for v in versions.values() if v != phoslab.__version__}
    if other or not versions:
        problem = f"has workers of phoslab {', '.join(sorted(other))}" if other else "has no workers"
        raise PhoslabError(
            f"{address} {problem}",
            field="--scheduler",
            remedy=f"Start workers with `dask worker {address}` where phoslab {phoslab.__version__} is installed.",
        )
    return sum(client.nthreads().values())


def _version() -> str:
    try:
        import phoslab as there
    except ImportError:
        return "(not installed)"
    return there.__version__


def _remote(
    client: Client, n_threads: int, problem: PixelProblem, strips: Iterable[Pixels]
) -> Iterator[PixelFits]:
    on_the_way: deque[Future[PixelFits]] = deque()
    for y in strips:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sending large graph")  # that is what it is for
            # One thread a task: a worker runs as many tasks as it has threads.
            on_the_way.append(client.submit(fit_pixels, problem, y, threads=1, pure=False))
        if len(on_the_way) > _AHEAD * n_threads:
            yield _taken(on_the_way.popleft())
    while on_the_way:
        yield _taken(on_the_way.popleft())


def _taken(future: Future[PixelFits]) -> PixelFits:
    from distributed import CancelledError
    from distributed.scheduler import KilledWorker

    try:
        found: PixelFits = future.result()
    except (KilledWorker, CancelledError, OSError) as error:
        raise PhoslabError(
            f"has lost the workers that fitted a strip of pixels ({type(error).__name__})",
            field="--scheduler",
            remedy="Look at the workers' logs; they may have run out of memory. Then do it again: nothing was written.",
        ) from error
    return found
