"""What a command or a piece of Python takes, in a process of its own: time, and the memory of it and all below it."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from phoslab.errors import PhoslabError

_POLL_S = 0.05


@dataclass(frozen=True)
class Took:
    """Seconds by the clock and of processors, bytes at most, and what was printed.

    `held_bytes` is what the processes hold alone and their share of what they hold together (PSS), polled twenty times
    a second; 0 where the system does not tell (Linux does). `cpu_s` is 0 likewise.
    """

    clock_s: float
    cpu_s: float
    held_bytes: int
    printed: str


def command(*words: str) -> Took:
    """Run `phoslab WORDS`.

    Raises:
        PhoslabError: it fails; its last words say why.
    """
    return _run([sys.executable, "-m", "phoslab", *words], f"phoslab {words[0]}")


def python(code: str, *words: str) -> Took:
    """Run a piece of Python with arguments; it fails as `command` does."""
    return _run([sys.executable, "-c", code, *words], "what is to be timed")


def _run(words: list[str], name: str) -> Took:
    before = _children_s()
    began, most = time.perf_counter(), 0
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            while process.poll() is None:
                most = max(most, _held_bytes(process.pid))
                time.sleep(_POLL_S)
        except BaseException:
            process.terminate()
            raise
        clock_s = time.perf_counter() - began
        printed, said = process.communicate()
    if process.returncode:
        last = said.strip().splitlines()[-1] if said.strip() else "it said nothing"
        raise PhoslabError(
            f"failed: {last.removeprefix('phoslab: ').removesuffix('.')}",
            field=name,
            remedy="Mend that and measure again.",
        )
    return Took(clock_s, _children_s() - before, most, printed)


def _held_bytes(pid: int) -> int:
    total = 0
    try:
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
        total += sum(1024 * int(kB) for kB in re.findall(r"^Pss: *(\d+)", rollup, re.MULTILINE))
        for thread in Path(f"/proc/{pid}/task").iterdir():
            total += sum(_held_bytes(int(child)) for child in (thread / "children").read_text().split())
    except OSError:  # it has ended meanwhile, or this is no Linux
        pass
    return total


def _children_s() -> float:
    """Seconds of processors that children which have ended took, all that they waited for included."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
