"""A camera's own software, as far as a drop folder sees it: writes a frame into a folder, slowly.

python vendor_software.py SOURCE FOLDER EXPOSURE_S [jpeg-beside] [cut] [fail]
"""

from __future__ import annotations

import itertools
import sys
import time
from pathlib import Path


def main() -> int:
    source, folder, exposure_s, *habits = sys.argv[1:]
    if "fail" in habits:
        print("no camera found", file=sys.stderr)
        return 3
    time.sleep(float(exposure_s))
    content = Path(source).read_bytes()
    if "cut" in habits:
        content = content[: len(content) // 2]
    free = next(k for k in itertools.count() if not (Path(folder) / f"IMG_{k:04d}.CR2").exists())
    if "jpeg-beside" in habits:
        (Path(folder) / f"IMG_{free:04d}.JPG").write_bytes(b"\xff\xd8\xff\xe1" + bytes(1000))
    with (Path(folder) / f"IMG_{free:04d}.CR2").open("wb") as frame:
        for start in range(0, len(content), 20_000):
            frame.write(content[start : start + 20_000])
            frame.flush()
            time.sleep(0.03)
    return 0


if __name__ == "__main__":
    sys.exit(main())
