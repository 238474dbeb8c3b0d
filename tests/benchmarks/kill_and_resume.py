"""Kill a simulated `measure all` at random moments (SIGKILL) and resume it, until it is complete; then fit its decay.

    python tests/benchmarks/kill_and_resume.py [KILLS] [SEED]

After each kill: every frame that the journal has ever acknowledged is there with the content that it had, and no line
of a journal has changed. A campaign that is complete is begun anew until there were enough kills.
"""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from phoslab.session import Session

PLANS = (
    *("--only", "lamp,lvf,emission,decay,excitation"),
    *("--set", "lamp.frames=1", "--set", "lvf.filters=L002,L201", "--set", "lvf.darks=1"),
    *("--set", "emission.charge_s=60", "--set", "emission.frames=1", "--set", "decay.charge_s=60"),
    *("--set", "decay.until_s=30", "--set", "excitation.dark_s=600", "--set", "excitation.last_s=8"),
    *("--set", "excitation.between=1", "--set", "excitation.darks=1"),
)
LONGEST_S = 9.0
"""Kills come up to so long after a start; starting takes some 3 s."""


class Kept:
    """All that has ever been acknowledged in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.frames: dict[Path, str] = {}
        self.lines: dict[Path, bytes] = {}

    def check(self) -> None:
        """Compare what is there with what was, and add what is new."""
        for journal in self.folder.glob("*/journal.jsonl"):
            content = journal.read_bytes()
            whole = content[: content.rfind(b"\n") + 1]
            before = self.lines.get(journal, b"")
            assert whole.startswith(before), f"{journal} was changed"
            self.lines[journal] = whole
            for line in whole[len(before) :].splitlines():
                event = json.loads(line)
                if event["event"] == "exposure":
                    self.frames[journal.parent / "frames" / event["frame"]] = event["sha256"]
        for path, digest in self.frames.items():
            assert hashlib.sha256(path.read_bytes()).hexdigest() == digest, f"{path} was changed"


def main(kills: int, seed: int) -> None:
    """Do it and print what came of it."""
    rng = random.Random(seed)
    counts: Counter[str] = Counter()
    began = time.monotonic()
    home = Path(tempfile.mkdtemp(prefix="phoslab-kill-"))
    print(f"in {home}, which stays if anything fails", flush=True)
    number = 0
    while counts["kills"] < kills:
        number += 1
        campaign(home / str(number), rng, kills, counts)
        shutil.rmtree(home / str(number))
    home.rmdir()
    print(
        f"{counts['kills']} kills, {counts['before']} of them before the first line, {counts['half']} in a line,"
    )
    print(f"{counts['orphans']} with a file that had no line yet; {number} campaigns completed,")
    print(
        f"{counts['frames']} acknowledged frames, all there and as they were; {counts['fits']} decays fitted."
    )
    print(f"{time.monotonic() - began:.0f} s")


def campaign(folder: Path, rng: random.Random, kills: int, counts: Counter[str]) -> None:
    """Measure one campaign to its end, with kills on the way."""
    kept = Kept(folder)
    while True:
        begun = (folder / "campaign.toml").exists()
        words = (
            ["resume", str(folder)]
            if begun
            else ["measure", "all", "--simulate", "green", "-o", str(folder), *PLANS]
        )
        process = subprocess.Popen(
            [sys.executable, "-m", "phoslab", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        killed = False
        try:
            told, _ = process.communicate(
                timeout=rng.uniform(0.5, LONGEST_S) if counts["kills"] < kills else None
            )
        except subprocess.TimeoutExpired:
            process.kill()
            told, _ = process.communicate()
            killed = True
        kept.check()
        if not killed:
            # The last line may be there, and the program be killed before it ends.
            assert process.returncode == 0 or "is complete" in told, told
            break
        counts["kills"] += 1
        counts["before"] += not kept.lines
        for journal, whole in kept.lines.items():
            counts["half"] += journal.stat().st_size > len(whole)
            known = {p for p in kept.frames if p.parent.parent == journal.parent}
            counts["orphans"] += bool(set((journal.parent / "frames").iterdir()) - known)
    counts["frames"] += len(kept.frames)
    for session in sorted(folder.glob("[0-9]*")):
        assert Session.open(session).complete
    words = ["fit", str(folder / "04-decay"), "--preset", "green", "-o", str(folder / "m.json")]
    subprocess.run([sys.executable, "-m", "phoslab", *words], check=True, stdout=subprocess.DEVNULL)
    counts["fits"] += 1


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
