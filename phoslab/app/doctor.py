"""Say what this machine has: Python, OpenGL, camera, serial ports, optional parts; and how to get the rest.

The exit code is 0 when everything that fitting and rendering need is there, 1 when OpenGL is missing.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

HELP = "what this machine has, and how to get the rest"
EXAMPLE = "phoslab doctor"

# Drivers run in a process of their own: one that crashes or hangs must not take the doctor with it.
_GL_PROBE = """
import json, moderngl
gl = moderngl.create_context(
    standalone=True, backend="egl", libgl="libGL.so.1", libegl="libEGL.so.1", require=430)
info = gl.info
print(json.dumps({"renderer": info["GL_RENDERER"], "version": info["GL_VERSION"],
                  "max_texture_size": info["GL_MAX_TEXTURE_SIZE"]}))
"""
_CAMERA_PROBE = """
import json, gphoto2
print(json.dumps({"cameras": [[name, port] for name, port in gphoto2.Camera.autodetect()]}))
"""
_PROBE_TIMEOUT_S = 60.0
# Programs that take a camera or a port for themselves as soon as it is plugged in, and how to keep them from it.
_RIVALS = {
    "gvfs-gphoto2-vo": (
        "gvfs holds every camera that is plugged in",
        "systemctl --user mask --now gvfs-gphoto2-volume-monitor.service",
    ),
    "gvfsd-gphoto2": (
        "gvfs has mounted the camera",
        "eject the camera in the file manager, or: gio mount --unmount-scheme gphoto2",
    ),
    "ModemManager": (
        "ModemManager talks to new serial ports, which resets a controller",
        "sudo systemctl disable --now ModemManager.service",
    ),
    "brltty": (
        "brltty takes CH340 serial adapters for Braille displays",
        "sudo systemctl mask --now brltty-udev.service",
    ),
}


@dataclass(frozen=True)
class Part:
    """One thing that a machine may have.

    `state` is "ok", "missing" (phoslab cannot do without) or "optional" (it can); `remedy` says how
    to get it, and is empty if there is nothing to get; `details` is for `--json`.
    """

    name: str
    state: str
    found: str
    remedy: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object, for machines")


def run(args: argparse.Namespace) -> int:
    import json

    parts = examine()
    ready = all(part.state != "missing" for part in parts)
    if args.json:
        print(json.dumps({"ready": ready, "parts": [asdict(part) for part in parts]}, indent=2))
    else:
        for part in parts:
            print(f"{part.name:<15}{part.state:<10}{_printable(part.found)}")
            if part.remedy:
                print(f"{'':<25}-> {part.remedy}")
    return 0 if ready else 1


def examine() -> list[Part]:
    """Look at everything, the mandatory parts first."""
    return [_python(), _phoslab(), _gl(), _machine(), _camera(), _serial_ports(), _rivals(), _reference()]


def _python() -> Part:
    import platform
    import sys

    return Part("Python", "ok", f"{platform.python_version()} ({sys.executable})")


def _phoslab() -> Part:
    from pathlib import Path

    import phoslab

    return Part("phoslab", "ok", f"{phoslab.__version__} ({Path(phoslab.__file__).parent})")


def _gl() -> Part:
    answer, problem = _probe(_GL_PROBE)
    if problem:
        return Part("OpenGL", "missing", problem, _gl_remedy(problem))
    from phoslab.trades import SOFTWARE_RENDERERS

    software = any(name in answer["renderer"].lower() for name in SOFTWARE_RENDERERS)
    where = "in software: works, slowly" if software else "on the GPU"
    found = f"{answer['version']}, {answer['renderer']} ({where})"
    return Part("OpenGL", "ok", found, details={**answer, "software": software})


def _gl_remedy(problem: str) -> str:
    import os
    import shutil

    if "No module named" in problem:
        return "phoslab is only half installed: pip install --force-reinstall phoslab"
    if shutil.which("apt-get"):
        sudo = "" if os.geteuid() == 0 else "sudo "
        return f"{sudo}apt-get install libgl1 libegl1 libgl1-mesa-dri"
    return (
        "install libGL.so.1, libEGL.so.1 and Mesa's DRI driver (OpenGL 4.3 or newer) "
        "with this system's package manager"
    )


def _machine() -> Part:
    import os

    cores = len(os.sched_getaffinity(0))
    memory_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return Part(
        "machine",
        "ok",
        f"{cores} cores, {memory_gib:.1f} GiB of memory",
        details={"cores": cores, "memory_gib": round(memory_gib, 1)},
    )


def _camera() -> Part:
    from importlib.util import find_spec

    if find_spec("gphoto2") is None:
        return Part("camera", "optional", "gphoto2 is not installed", 'pip install "phoslab[camera]"')
    answer, problem = _probe(_CAMERA_PROBE)
    if problem:
        return Part("camera", "optional", problem, "pip install --force-reinstall gphoto2")
    cameras = answer["cameras"]
    if not cameras:
        remedy = "connect it by USB, switch it on, and close every other program that uses it"
        return Part("camera", "optional", "none connected", remedy, answer)
    found = "; ".join(f"{name} at {port}" for name, port in cameras)
    if not all(_may_open(port) for _, port in cameras):
        remedy = "sudo apt-get install libgphoto2-6, whose udev rules let you open it; then plug it in again"
        return Part("camera", "optional", f"{found}: not yours to open", remedy, answer)
    return Part("camera", "ok", found, details=answer)


def _may_open(port: str) -> bool:
    """Whether this user may open a camera at "usb:001,004"; true where there is nothing to look at."""
    import os

    bus, _, device = port.removeprefix("usb:").partition(",")
    node = f"/dev/bus/usb/{bus}/{device}"
    return not os.path.exists(node) or os.access(node, os.R_OK | os.W_OK)  # noqa: PTH110  # pathlib is not loaded


def _serial_ports() -> Part:
    import os

    from serial.tools import list_ports

    ports = [
        {
            "device": port.device,
            "usb_id": None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
            "serial_number": port.serial_number,
            "description": port.description,
            "writable": os.access(port.device, os.R_OK | os.W_OK),
        }
        for port in sorted(list_ports.comports())
    ]
    details = {"ports": ports}
    usb = [port for port in ports if port["usb_id"]]
    if not usb:
        others = f" (on board: {', '.join(str(port['device']) for port in ports)})" if ports else ""
        remedy = "connect the lamp and the door by their USB adapters"
        return Part("serial ports", "optional", f"none on USB{others}", remedy, details)
    found = "; ".join(f"{port['device']} [{port['usb_id']}] {port['description']}" for port in usb)
    if not all(port["writable"] for port in usb):
        remedy = 'sudo usermod -aG dialout "$USER", then log in again'
        return Part("serial ports", "optional", f"{found}: not yours to open", remedy, details)
    return Part("serial ports", "ok", found, details=details)


def _rivals() -> Part:
    """Other programs that grab what the rig needs."""
    running = _running()
    found = [_RIVALS[name] for name in _RIVALS if name in running]
    if not found:
        return Part("other programs", "ok", "none that takes cameras or serial ports for itself")
    said, remedies = zip(*found, strict=True)
    return Part("other programs", "optional", "; ".join(said), "; ".join(remedies))


def _running() -> set[str]:
    """Names of all running programs, as far as the system tells (cut to 15 characters)."""
    from pathlib import Path

    names = set()
    for path in Path("/proc").glob("[0-9]*/comm"):
        try:
            names.add(path.read_text().strip())
        except OSError:
            continue  # it has ended meanwhile
    return names


def _reference() -> Part:
    from importlib.metadata import version
    from importlib.util import find_spec

    if find_spec("mitsuba") is None:
        remedy = "pip install mitsuba"
        return Part("reference", "optional", "the path tracer mitsuba is not installed", remedy)
    return Part("reference", "ok", f"mitsuba {version('mitsuba')}")


def _probe(program: str) -> tuple[dict[str, Any], str]:
    """Run a Python program that prints one JSON object; return that, or what went wrong."""
    import json
    import signal
    import subprocess
    import sys

    try:
        # -P: a file in the current folder must not pass for a library.
        done = subprocess.run(
            [sys.executable, "-P", "-c", program],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {}, f"its driver did not answer within {_PROBE_TIMEOUT_S:.0f} s"
    if done.returncode < 0:
        return {}, f"its driver crashed ({signal.Signals(-done.returncode).name})"
    if done.returncode > 0:
        last = done.stderr.strip().splitlines()[-1:] or ["its driver said nothing"]
        return {}, last[0]
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer, ""


def _printable(text: str) -> str:
    """`text` without control characters: a USB device may call itself anything."""
    return "".join(character if character.isprintable() else "?" for character in text)
