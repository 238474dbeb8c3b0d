"""Limited processes: a bad job costs itself, whatever it does."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import phoslab
from phoslab.limited import Failure, Limits, Workers, _pack, _unpack


def test_answers_come_in_the_order_of_the_jobs() -> None:
    with Workers(2) as workers:
        naps = [{"args": [f"(__import__('time').sleep({s}), {s})[1]"]} for s in (0.2, 0.0, 0.1, 0.0)]
        answers = workers.run("builtins:eval", naps)
    assert answers == [{"value": s} for s in (0.2, 0.0, 0.1, 0.0)]


def test_workers_persist_over_jobs() -> None:
    with Workers(1) as workers:
        first = workers.run("os:getpid", [{}, {}])
        assert first == workers.run("os:getpid", [{}] * 2)
        assert first[0] != {"value": os.getpid()}


def test_two_workers_work_at_the_same_time() -> None:
    with Workers(2) as workers:
        workers.run("os:getpid", [{}, {}])
        start = time.monotonic()
        workers.run("time:sleep", [{"args": [0.5]}] * 2)
        assert time.monotonic() - start < 0.9


@pytest.mark.parametrize(
    ("job", "limits", "reason"),
    [
        ("__import__('time').sleep(60)", Limits(wall_s=0.5), "took longer than 0.5 s"),
        ("sum(iter(int, 1))", Limits(wall_s=20, cpu_s=1), "took more than 1 s of processor time"),
        ("bytearray(1 << 33)", Limits(memory_bytes=1 << 30), "needs more than 1 GiB of memory"),
        ("[os.write(os.memfd_create('a'), b'x') for os in [__import__('os')]]", Limits(), "File too large"),
        ("__import__('os').abort()", Limits(), "crashed the decoder .SIGABRT."),
        ("__import__('os')._exit(3)", Limits(), "crashed the decoder .exit code 3."),
        ("1 / 0", Limits(), "failed: ZeroDivisionError"),
        ("object()", Limits(), "failed: TypeError"),
        ("print('noise on stdout') or 5", Limits(), None),
    ],
)
def test_a_job_that_breaks_a_limit_fails_alone(job: str, limits: Limits, reason: str | None) -> None:
    with Workers(1, limits) as workers:
        first, bad, last = workers.run("builtins:eval", [{"args": ["1"]}, {"args": [job]}, {"args": ["2"]}])
    assert (first, last) == ({"value": 1}, {"value": 2})
    if reason is None:
        assert bad == {"value": 5}
    else:
        assert isinstance(bad, Failure)
        assert re.search(reason, bad.reason)


def test_a_worker_that_answers_nonsense_is_replaced() -> None:
    """A hostile file that takes the decoder over can write what it likes; it can still not hurt the parent."""
    write = (
        "[os.write(fd, b'\\xff' * 4096) for os in [__import__('os')] "
        "for fd in range(3, 9) if os.path.exists(f'/proc/self/fd/{fd}')]"
    )
    with Workers(1) as workers:
        (bad,) = workers.run("builtins:eval", [{"args": [write]}])
        assert isinstance(bad, Failure)
        assert "nonsense" in bad.reason
        assert workers.run("math:sqrt", [{"args": [4]}]) == [{"value": 2.0}]


def test_leaving_early_stops_what_still_runs() -> None:
    with Workers(2) as workers:
        jobs = [{"args": [0]}, {"args": [60]}]
        start = time.monotonic()
        assert next(workers.run_as_done("time:sleep", jobs)) == (0, {"value": None})
        assert workers.run("math:sqrt", [{"args": [4]}] * 2) == [{"value": 2.0}] * 2
        assert time.monotonic() - start < 20


def test_messages_survive_the_pipe() -> None:
    arrays = {
        "a": np.arange(6, dtype=np.uint16).reshape(2, 3),
        "b": np.array([np.nan]),
        "c": np.zeros((0, 2)),
    }
    buffer = bytearray(_pack({**arrays, "plain": [1, None, "é"]}))
    assert _unpack(buffer[:-1]) is None
    message = _unpack(buffer)
    assert message is not None
    assert message["plain"] == [1, None, "é"]
    for name, array in arrays.items():
        np.testing.assert_array_equal(message[name], array)
        assert message[name].dtype == array.dtype
    with pytest.raises(ValueError, match="more than one"):
        _unpack(buffer + b"x")


def test_a_script_without_a_main_guard_may_use_workers(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from phoslab.limited import shared\nprint(shared().run('math:sqrt', [{'args': [9]}]))\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={**os.environ, "PYTHONPATH": str(Path(phoslab.__file__).parent.parent)},
    )
    assert done.stdout == "[{'value': 3.0}]\n"
