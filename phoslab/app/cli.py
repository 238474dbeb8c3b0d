"""The command line: parse, run one command, turn errors into one sentence and an exit code.

A command is one module of this package and one line in `COMMANDS`. The module has `HELP` (one line),
`EXAMPLE`, `configure(parser)` and `run(args) -> exit code`, and imports what it works with inside `run`,
so that `phoslab --help` stays fast and no command loads what it does not use.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from phoslab import __version__
from phoslab.errors import PhoslabError, printable

COMMANDS = (
    "demo",
    "doctor",
    "measure",
    "resume",
    "calibrate",
    "spectrum",
    "fit",
    "classify",
    "presets",
    "export",
    "plan",
    "render",
    "trade",
)

DONE, FAILED, BAD_USAGE = 0, 1, 2  # argparse itself exits with 2


def build_parser() -> argparse.ArgumentParser:
    """Build the parser of every command."""
    parser = argparse.ArgumentParser(
        prog="phoslab", description="Measure, fit and render glow-in-the-dark materials."
    )
    parser.add_argument("--version", action="version", version=f"phoslab {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = importlib.import_module(f"phoslab.app.{name}")
        command = commands.add_parser(
            name,
            help=module.HELP,
            description=module.__doc__,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(command)
        command.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return 0 (done), 1 (failed) or 2 (bad usage)."""
    _open_streams()
    # Our matrices are small: where BLAS shares each among threads, `calibrate` takes twice as long, and thrice the
    # processor. NumPy reads this when it is first imported, by the command.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        with _asked_to_end():
            args = build_parser().parse_args(arguments)
            code: int = args.run(args)
            sys.stdout.flush()
        return code
    except PhoslabError as error:
        _say(str(error))
    except KeyboardInterrupt:
        _say("interrupted; nothing half-written was left.")
    except BrokenPipeError:
        # The reader of our output has gone (`phoslab presets | head -1`): not an error of ours.
        _forget_output()
        return DONE
    except OSError as error:
        _say(f"{error.filename or 'output'}: {error.strerror or error}. Check the disk and its permissions.")
        _forget_output()
    except Exception as error:
        if os.environ.get("PHOSLAB_TRACEBACK"):
            raise
        _say(
            f"internal error: {type(error).__name__}: {error}. "
            "This is a bug in phoslab: set PHOSLAB_TRACEBACK=1, run again and report what it prints."
        )
    return FAILED


@contextmanager
def _asked_to_end() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does: files are whole or absent, and processes end with it."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            # What somebody ignores (nohup) stays ignored.
            if signal.getsignal(number) == signal.SIG_DFL:
                before[number] = signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open_streams() -> None:
    """Make output work where it was closed (`>&-`), or where the locale cannot print a ±."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: PTH123, SIM115  # open until the end
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _say(message: str) -> None:
    print(printable(f"phoslab: {message}"), file=sys.stderr)


def _forget_output() -> None:
    """What could not be printed cannot be printed at exit either."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
