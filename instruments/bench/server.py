"""The bench's socket: one thread a connection, one line of JSON a request and an answer."""

from __future__ import annotations

import contextlib
import json
import socket
import socketserver
import struct
import threading
import time
from pathlib import Path
from typing import Any

from phoslab.errors import PhoslabError
from phoslab.instruments.bench.laboratory import Laboratory
from phoslab.instruments.simulated import LONGEST


class Server(socketserver.ThreadingUnixStreamServer):
    """Listens until nobody has been connected for a while.

    Args:
        path: of the socket.
        laboratory: what it is about.
        linger_s: real time for which it waits for a host that may come back.
    """

    daemon_threads = True
    request_queue_size = 64
    block_on_close = False

    def __init__(self, path: Path, laboratory: Laboratory, linger_s: float) -> None:
        super().__init__(str(path), _Connection)
        self.laboratory = laboratory
        self._linger_s = linger_s
        self._connected = 0
        self._counting = threading.Lock()
        self._last = time.monotonic()
        self._ending = False

    def end(self) -> None:
        """Serve no longer; to be called at any moment by a signal, which must not raise: this class swallows errors."""
        self._ending = True

    def count(self, by: int) -> None:
        """Count a connection that comes (1) or goes (-1)."""
        with self._counting:
            self._connected += by
            self._last = time.monotonic()

    def service_actions(self) -> None:
        """Called between requests: end if that was asked for, or if nobody has come back."""
        forgotten = not self._connected and time.monotonic() - self._last > self._linger_s
        if self._ending or forgotten:
            threading.Thread(target=self.shutdown, daemon=True).start()


class _Connection(socketserver.StreamRequestHandler):
    server: Server

    def setup(self) -> None:
        super().setup()
        peer = struct.Struct("3i")  # process, user, group
        self._pid = peer.unpack(self.request.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, peer.size))[0]

    def handle(self) -> None:
        self.server.count(1)
        try:
            while (line := self.rfile.readline(LONGEST)).endswith(b"\n"):
                answer, body = self._answer(line)
                if body is not None:
                    answer["bytes"] = len(body)
                self.wfile.write(json.dumps(answer).encode() + b"\n" + (body or b""))
        except OSError:
            pass  # the host is gone
        finally:
            self.server.count(-1)

    def finish(self) -> None:
        with contextlib.suppress(OSError):
            super().finish()

    def _answer(self, line: bytes) -> tuple[dict[str, Any], bytes | None]:
        try:
            asked = json.loads(line)
            answer, body = self.server.laboratory.answer(str(asked.pop("do")), asked, self._pid)
        except PhoslabError as error:
            said = {"problem": error.problem, "remedy": error.remedy, "field": error.field}
            return {"ok": False, "code": getattr(error, "code", ""), **said}, None
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            problem = f"does not understand the request ({type(error).__name__}: {error})"
            return {
                "ok": False,
                "problem": problem,
                "remedy": "Host and bench are of different versions.",
            }, None
        return {"ok": True, **answer}, body
