"""Measure what `phoslab --help` costs over an empty Python: python tests/benchmarks/help_cost.py [RUNS]

The aim is under 0.3 s. The two take turns, so that a busy machine slows both.
"""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median


def seconds(*arguments: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main(runs: int = 20) -> None:
    empty, helped = [], []
    for _ in range(runs + 1):
        empty.append(seconds("-c", "pass"))
        helped.append(seconds("-m", "phoslab", "--help"))
    # The first of each filled the disk cache.
    empty_s, help_s = median(empty[1:]), median(helped[1:])
    print(f"python -c pass   {empty_s:.3f} s   (medians of {runs} runs)")
    print(f"phoslab --help   {help_s:.3f} s")
    print(f"difference       {help_s - empty_s:.3f} s")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
