"""Functions run in limited processes, for files that nobody vouches for.

A decoder in C may crash, hang or eat the memory on a hostile file. It runs in a worker process with a
limit on wall time, CPU time, memory and written files; a worker that breaks one is replaced, and only
its own job fails. Workers persist over jobs, so that a series of frames pays their start once.

Jobs and answers are JSON and plain arrays, never pickles: a worker taken over by a file cannot run
code in the parent. Workers are started by `python -c` and not by multiprocessing, which would run the
user's script a second time if that has no `if __name__ == "__main__"`.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import math
import os
import selectors
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

_ARRAYS = {"bool", "uint8", "uint16", "int64", "float32", "float64"}
_LARGEST_ANSWER_BYTES = 1 << 31
_START_S = 60.0  # importing numpy from a cold, slow disk is not the file's fault


@dataclass(frozen=True)
class Limits:
    """What one job may use: seconds of wall and CPU time, and the worker's address space in bytes.

    The memory holds a 100 megapixel frame (200 MB as it is stored) several times over.
    """

    wall_s: float = 60.0
    cpu_s: float = 60.0
    memory_bytes: int = 4 << 30


@dataclass(frozen=True)
class Failure:
    """A job that gave no answer, and why, as the rest of a sentence ("took longer than 60 s")."""

    reason: str


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    job: int | None = None
    deadline: float = math.inf
    answer: bytearray = field(default_factory=bytearray)
    started: bool = False


class Workers:
    """A few limited processes that run jobs. Close it, or use it as a context manager.

    Args:
        n: how many; by default one for each processor that this process may use, at most 4.
        limits: of each job.

    >>> with Workers(1) as workers:
    ...     print(workers.run("math:sqrt", [{"args": [2.25]}, {"args": ["two"]}]))
    [{'value': 1.5}, Failure(reason='failed: TypeError: must be real number, not str')]
    """

    def __init__(self, n: int | None = None, limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self._n = n or min(4, len(os.sched_getaffinity(0)))
        self._workers: list[_Worker] = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop every worker."""
        while self._workers:
            self._stop(self._workers[-1])

    def run(self, function: str, jobs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any] | Failure]:
        """Run `function` once for each job; return the answers in the order of the jobs."""
        answers = dict(self.run_as_done(function, jobs))
        return [answers[index] for index in range(len(jobs))]

    def run_as_done(
        self, function: str, jobs: Sequence[Mapping[str, Any]]
    ) -> Iterator[tuple[int, dict[str, Any] | Failure]]:
        """Run `function` once for each job; yield (index, answer) as each is done.

        Args:
            function: "module:name". It returns a dict of JSON values and arrays (of bool, uint8, uint16,
                int64, float32 or float64); anything else that JSON holds comes back as {"value": it}.
            jobs: keyword arguments, JSON values and arrays; "args" holds positional ones.
        """
        waiting = list(range(len(jobs)))[::-1]
        try:
            while waiting or any(w.job is not None for w in self._workers):
                while waiting and (worker := self._idle()):
                    index = waiting[-1]
                    if self._give(worker, index, _pack({"function": function, **jobs[index]})):
                        waiting.pop()
                yield from self._wait()
        finally:
            # Left early: what still runs would answer a question that nobody asks any more.
            for worker in [w for w in self._workers if w.job is not None]:
                self._stop(worker)

    def _idle(self) -> _Worker | None:
        for worker in self._workers:
            if worker.job is None:
                return worker
        if len(self._workers) < self._n:
            self._workers.append(_Worker(_start(self.limits)))
            return self._workers[-1]
        return None

    def _give(self, worker: _Worker, index: int, message: bytes) -> bool:
        assert worker.process.stdin is not None
        try:
            worker.process.stdin.write(message)
            worker.process.stdin.flush()
        except OSError:  # it died while idle
            self._stop(worker)
            return False
        worker.job, worker.answer = index, bytearray()
        worker.deadline = time.monotonic() + self.limits.wall_s + (0.0 if worker.started else _START_S)
        return True

    def _wait(self) -> Iterator[tuple[int, dict[str, Any] | Failure]]:
        """Wait until a worker has something to say or is out of time; yield what got done."""
        busy = [w for w in self._workers if w.job is not None]
        with selectors.DefaultSelector() as selector:
            for worker in busy:
                assert worker.process.stdout is not None
                selector.register(worker.process.stdout, selectors.EVENT_READ, worker)
            patience = max(0.0, min(w.deadline for w in busy) - time.monotonic())
            ready: list[_Worker] = [key.data for key, _ in selector.select(patience)]
        for worker in busy:
            assert worker.job is not None
            index = worker.job
            outcome: dict[str, Any] | Failure | None = None
            if worker in ready:
                outcome = self._listen(worker)
            elif time.monotonic() > worker.deadline:
                self._stop(worker)
                outcome = Failure(f"took longer than {self.limits.wall_s:g} s")
            if outcome is not None:
                worker.job = None
                yield index, outcome

    def _listen(self, worker: _Worker) -> dict[str, Any] | Failure | None:
        assert worker.process.stdout is not None
        piece = os.read(worker.process.stdout.fileno(), 1 << 20)
        if not piece:
            # It has closed its end and is on its way out: its own exit code says why.
            with contextlib.suppress(subprocess.TimeoutExpired):
                worker.process.wait(1.0)
            code = self._stop(worker)
            if code in (-signal.SIGXCPU, -signal.SIGALRM):
                return Failure(f"took more than {self.limits.cpu_s:g} s of processor time")
            return Failure(f"crashed the decoder ({_signal_name(code)})")
        worker.answer += piece
        try:
            if worker.answer[0:1] == b"R" and not worker.started:  # ready: from now on its time is its job's
                worker.started, worker.deadline = True, time.monotonic() + self.limits.wall_s
                del worker.answer[0:1]
            answer = _unpack(worker.answer)
        except ValueError as error:
            self._stop(worker)
            return Failure(f"made the decoder answer nonsense ({error})")
        if answer is None:
            return None
        return Failure(str(answer["error"])[:300]) if "error" in answer else answer

    def _stop(self, worker: _Worker) -> int:
        self._workers.remove(worker)
        process = worker.process
        process.kill()
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            with contextlib.suppress(OSError):
                pipe.close()
        return process.wait()


@cache
def shared() -> Workers:
    """The workers that all of this program shares; stopped when it ends."""
    workers = Workers()
    atexit.register(workers.close)
    return workers


def _signal_name(code: int) -> str:
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"exit code {code}"


def _start(limits: Limits) -> subprocess.Popen[bytes]:
    """Start a worker that sees the parent's import path and nothing else of it."""
    settings = json.dumps([sys.path, limits.wall_s, limits.cpu_s, limits.memory_bytes])
    return subprocess.Popen(
        [
            sys.executable,
            "-P",  # not even `import json` may come from the current folder, which may be a session's
            "-c",
            "import json, sys; settings = json.loads(sys.argv[1]); sys.path[:] = settings[0]; "
            "from phoslab.limited import _work; _work(*settings[1:])",
            settings,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # Each thread's stack and arena counts against the memory limit, and the work is one frame a worker.
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"},
    )


def _work(wall_s: float, cpu_s: float, memory_bytes: int) -> None:
    """The worker's life: limit itself, then answer jobs from stdin until it closes."""
    import resource

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then stops its workers
    # Libraries print to stdout; the answers go where nobody prints.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    for kind, limit in (
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        # A hard limit that the system already set lower stays.
        hard = resource.getrlimit(kind)[1]
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (limit, limit))
    answers.write(b"R")
    answers.flush()
    while header := sys.stdin.buffer.read(8):
        message = bytearray(header + sys.stdin.buffer.read(struct.unpack("<Q", header)[0]))
        job = _unpack(message)
        if job is None:
            return
        # The limit counts the process's whole life. The alarm acts even if the parent is gone.
        used = resource.getrusage(resource.RUSAGE_SELF)
        soft = math.ceil(used.ru_utime + used.ru_stime + cpu_s)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        signal.alarm(math.ceil(wall_s) + 5)
        try:
            module, _, name = job.pop("function").partition(":")
            answer = getattr(importlib.import_module(module), name)(*job.pop("args", ()), **job)
            packed = _pack(answer if isinstance(answer, dict) else {"value": answer})
        except MemoryError:
            packed = _pack({"error": f"needs more than {memory_bytes / 2**30:.3g} GiB of memory"})
        except Exception as error:
            packed = _pack({"error": f"failed: {type(error).__name__}: {error}"})
        signal.alarm(0)
        answers.write(packed)
        answers.flush()


def _pack(message: Mapping[str, Any]) -> bytes:
    """8 bytes of length; 4 bytes of length and the JSON part; the arrays, one after the other."""
    arrays = {k: np.ascontiguousarray(v) for k, v in message.items() if isinstance(v, np.ndarray)}
    plain = {k: v for k, v in message.items() if k not in arrays}
    shapes = [[k, v.dtype.name, v.shape] for k, v in arrays.items()]
    text = json.dumps([plain, shapes]).encode()
    body = b"".join([struct.pack("<I", len(text)), text, *(v.tobytes() for v in arrays.values())])
    return struct.pack("<Q", len(body)) + body


def _unpack(buffer: bytearray) -> dict[str, Any] | None:
    """The inverse of `_pack`; None while bytes are still to come.

    Raises:
        ValueError: it is no such message.
    """
    if len(buffer) < 8:
        return None
    (length,) = struct.unpack_from("<Q", buffer)
    if length > _LARGEST_ANSWER_BYTES:
        raise ValueError(f"{length} bytes")
    if len(buffer) < 8 + length:
        return None
    if len(buffer) > 8 + length:
        raise ValueError("more than one answer")
    try:
        (text_length,) = struct.unpack_from("<I", buffer, 8)
        start = 12 + text_length
        plain, shapes = json.loads(bytes(buffer[12:start]))
        message = dict(plain)
        for name, dtype, shape in shapes:
            if dtype not in _ARRAYS or any(not isinstance(n, int) or n < 0 for n in shape):
                raise ValueError(f"an array of {dtype}")
            count = math.prod(shape)
            message[name] = np.frombuffer(buffer, dtype, count, start).reshape(shape).copy()
            start += count * np.dtype(dtype).itemsize
    except (struct.error, TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    return message
