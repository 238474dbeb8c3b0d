"""The simulated bench as a process of its own: `python -m phoslab.instruments.bench --folder DIR --sample green`.

`phoslab.instruments.bench.rig.start` starts it. It ends when nobody has been connected for a while.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
from datetime import UTC, datetime
from pathlib import Path

from phoslab.errors import PhoslabError
from phoslab.files import write_text
from phoslab.instruments.bench.body import Body
from phoslab.instruments.bench.camera import CANON
from phoslab.instruments.bench.darkroom import Darkroom
from phoslab.instruments.bench.faults import parse
from phoslab.instruments.bench.host import Host
from phoslab.instruments.bench.laboratory import Laboratory
from phoslab.instruments.bench.rig import ENDPOINTS
from phoslab.instruments.bench.samples import sample
from phoslab.instruments.bench.server import Server
from phoslab.instruments.bench.timekeeper import Timekeeper

START = "2026-01-15T18:00:00+00:00"


def main(arguments: list[str] | None = None) -> int:
    """Be a bench until nobody needs it; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m phoslab.instruments.bench", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="where it says how to reach it")
    parser.add_argument("--sample", default="green", help="what the samples are")
    parser.add_argument("--seed", type=int, default=0, help="of all that is random")
    parser.add_argument("--fault", action="append", default=[], help="NAME@12 or NAME@90s")
    parser.add_argument("--linger", type=float, default=60.0, help="seconds to wait for a host that has gone")
    parser.add_argument("--start", default=START, help="what the wall clock shows at first")
    parser.add_argument(
        "--mono", type=float, default=0.0, help="what the monotonic clock shows at first, in s"
    )
    parser.add_argument("--card-frames", type=int, default=500, help="how many frames the card holds")
    parser.add_argument("--size", type=int, nargs=2, default=CANON.shape, help="rows and columns of a frame")
    parser.add_argument("--session", help="the session that it serves")
    parser.add_argument("--temporary", action="store_true", help="remove the folder at the end")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the host; the bench sees to the lamp
    signal.signal(signal.SIGTERM, lambda *_: _end())
    os.umask(0o077)  # socket and clock are for their owner
    folder: Path = options.folder
    laboratory = None
    try:
        start = datetime.fromisoformat(options.start)
        if start.tzinfo is None:
            start = start.replace(tzinfo=UTC)
        h, w = options.size
        keeper = Timekeeper(folder, start, options.mono)
        room = Darkroom(options.seed, sample(options.sample), CANON.resized((h, w)), born_s=options.mono)
        body = Body(room, keeper, salt=int(start.timestamp()), card_frames=options.card_frames)
        host, faults = Host(folder, options.session), [parse(text) for text in options.fault]
        laboratory = Laboratory(folder, room, keeper, body, host, faults)
        socket = folder / "socket"
        with Server(socket, laboratory, options.linger) as server:
            about = {"seed": options.seed, "session": options.session}
            endpoints = {"pid": os.getpid(), "socket": str(socket), "sample": options.sample}
            signal.signal(signal.SIGTERM, lambda *_: server.end())
            write_text(folder / ENDPOINTS, json.dumps(endpoints | about) + "\n")
            server.serve_forever(poll_interval=0.1)
    except _EndError:
        pass
    except PhoslabError as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        if laboratory is not None:
            laboratory.close()
        for name in (ENDPOINTS, "socket", "port"):
            (folder / name).unlink(missing_ok=True)
    if options.temporary:
        shutil.rmtree(folder, ignore_errors=True)
    return 0


class _EndError(Exception):
    """Somebody asked for an end."""


def _end() -> None:
    raise _EndError


if __name__ == "__main__":
    sys.exit(main())
