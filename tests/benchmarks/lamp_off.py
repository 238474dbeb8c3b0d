"""How long the lamp stays on after the host has been killed: python tests/benchmarks/lamp_off.py [N]

Starts a host process that switches the lamp on and keeps it on, kills it (kill -9) at a random moment of its
heartbeat, and notes when the board's output goes off, by this machine's clock. N times (20) for each: the firmware
under simavr, the simulated controller, a relay board with its guardian. The limit is 2.5 s: 2 s without a heartbeat,
the rest for the way of the last one and the board. Where the machine is too slow for simavr, simulated time lags
behind the wall clock meanwhile; how much, at most, is the last column, and the limit holds without it.
"""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "instruments"))
from boards import HERE, SIMULATED, BoardProcess, build_firmware, same_phoslab

LIMIT_S = 2.5
HOST = """
import sys, time
if sys.argv[2] == "rig":
    from phoslab.instruments.controller import RigController
    lamp = RigController(sys.argv[1], max_on_s=3600.0).lamp
else:
    from phoslab.instruments.relays import RelayLamp
    lamp = RelayLamp(sys.argv[1], sys.argv[2], accept_no_failsafe=True)
lamp.stage()
lamp.allow_until(time.monotonic() + 600)
lamp.set("on").wait(9)
print("on", flush=True)
time.sleep(600)
"""


def lamp_off_s(board: BoardProcess, kind: str) -> tuple[float, float]:
    """Kill one host; return how long the lamp stayed on, and how much of it the simulation was late."""
    seen = len(board.pins)
    host = subprocess.Popen(
        [sys.executable, "-c", HOST, board.port, kind], stdout=subprocess.PIPE, env=same_phoslab()
    )
    with host:
        assert host.stdout is not None
        if host.stdout.readline() != b"on\n":
            raise SystemExit("the host did not switch on (its own words are above)")
        time.sleep(random.uniform(0.6, 1.6))
        board.do("time")
        killed_s = time.monotonic()
        host.kill()
    then, off = board.pin("time", 0, after=seen), board.pin("lamp", 0, after=seen)
    lag_s = off.mono_s - then.mono_s - (off.board_us - then.board_us) * 1e-6 if off.board_us else 0.0
    return off.mono_s - killed_s, max(0.0, lag_s)


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    random.seed(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        boards = {
            "firmware under simavr": (build_firmware(folder), "rig"),
            "simulated controller": (SIMULATED, "rig"),
            "relay board, guardian": ([sys.executable, str(HERE / "relay_board.py"), "lcus-1"], "lcus-1"),
        }
        late = False
        print(f"lamp off after kill -9, {n} each                 min   median      max  lag [s]", flush=True)
        for what, (command, kind) in boards.items():
            board = BoardProcess(command, folder / kind)
            times, lags = np.array([lamp_off_s(board, kind) for _ in range(n)]).T
            board.close()
            late |= bool((times - lags).max() > LIMIT_S)
            least, middle, most = times.min(), np.median(times), times.max()
            print(f"{what:<40}{least:10.3f}{middle:9.3f}{most:9.3f}{lags.max():9.3f}", flush=True)
    sys.exit(f"more than {LIMIT_S} s" if late else 0)


if __name__ == "__main__":
    main()
