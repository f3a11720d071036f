"""Start the app's server, print its address, and make sure that Ctrl-C stops it even if models or clients hang."""

from __future__ import annotations

import logging
import os
import secrets
import signal
import socket
import subprocess
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, cast

import uvicorn

from ..errors import UsageError
from ..models import ModelSpec
from .choices import Models
from .guard import Guard
from .pairs import SourceStore
from .prediction_queue import PredictionQueue
from .server import FILES, build
from .upload_folder import UploadFolder

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8642
_HEADER_SECONDS = 5
"""Connections without a complete request are closed after one to two times this many seconds."""
_ENDING_SECONDS = 8.0
"""Seconds after Ctrl-C until the app is killed if it has not stopped."""


def serve(
    given: Sequence[ModelSpec],
    host: str | None = None,
    port: int | None = None,
    browser: bool = True,
    say: Callable[[str], None] = print,
    warn: Callable[[str], None] = print,
) -> None:
    """Serve until interrupted."""
    listening = _listen(host or LOOPBACK, port)
    number = listening.getsockname()[1]
    others = not _is_loopback(listening.getsockname()[0])
    if others:
        warn("anyone who can reach this machine and knows the address can use this app and the models that it loads")
    token = secrets.token_urlsafe(24)
    shown = f"[{host}]" if host and ":" in host else host or LOOPBACK
    address = f"http://{LOOPBACK if shown in ('0.0.0.0', '[::]') else shown}:{number}/?token={token}"
    # a malformed upload is answered on the page; without a handler, its parser would also print to the terminal
    logging.getLogger("python_multipart").addHandler(logging.NullHandler())
    sources, queue, uploads = SourceStore(), PredictionQueue(), UploadFolder()
    guarded = Guard(build(Models(given), sources, queue, uploads), token, number, FILES, (host or "") if others else "")
    config = uvicorn.Config(
        guarded,
        http="h11",
        log_level="error",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="none",
        proxy_headers=False,
        timeout_graceful_shutdown=1,
        timeout_notify=_HEADER_SECONDS,
    )
    say(f"robustflow app: {address} (press Ctrl-C to stop)")
    if browser:
        threading.Timer(0.5, webbrowser.open, (_redirect(uploads.path, address).as_uri(),)).start()
    try:
        _exit_on_signal()
        _Server(config, queue).run(sockets=[listening])
    except KeyboardInterrupt:
        pass  # the normal way to stop this server
    finally:
        listening.close()
        sources.close()
        uploads.close()


class _Server(uvicorn.Server):
    """A server that does not wait for a prediction when it is stopped, nor for requests that are never completed."""

    def __init__(self, config: uvicorn.Config, queue: PredictionQueue) -> None:
        super().__init__(config)
        self._queue = queue
        self._incomplete: dict[Any, Any] = {}
        config.callback_notify = self._close_incomplete

    async def _close_incomplete(self) -> None:
        """Close connections that have not completed a request since the last call."""
        before, self._incomplete = self._incomplete, {}
        for connection in cast(Any, self.server_state.connections):
            request = connection.cycle
            if request is None or request.response_complete:
                if connection in before and before[connection] is request:
                    connection.transport.abort()
                self._incomplete[connection] = request

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """See uvicorn."""
        self._queue.close()
        super().handle_exit(sig, frame)


def _redirect(folder: Path, address: str) -> Path:
    """Write a page that only this user can read and that opens an address, which would be visible to all users as an
    argument of the browser."""
    path = folder / "open.html"
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(f'<!DOCTYPE html><title>RobustFlow</title><meta http-equiv="refresh" content="0;url={address}">')
    return path


def _listen(host: str, port: int | None) -> socket.socket:
    """Return a socket on the requested port, or on any port if none was requested and the default port is in use."""
    if port is not None and not 0 <= port <= 65535:
        raise UsageError(f"port {port} is out of range: give 1 to 65535, or 0 for any")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for number in (DEFAULT_PORT, 0) if port is None else (port,):
        listening = socket.socket(family, socket.SOCK_STREAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((host, number))
            listening.listen(64)
        except (OSError, TypeError, ValueError) as error:  # not all impossible host names raise an OSError
            listening.close()
            reason = getattr(error, "strerror", None) or str(error)
            continue
        return listening
    raise UsageError(f"cannot listen on {host} port {number}: {reason}; choose a different --port or --host")


def _is_loopback(address: str) -> bool:
    return address == "::1" or address.startswith("127.")


_WATCH = f"""
import os, select, signal, sys
while True:
    sent = os.read(0, 1)
    if not sent:
        sys.exit()
    if sent[0] in ({signal.SIGINT:d}, {signal.SIGTERM:d}):
        break
while select.select([0], [], [], {_ENDING_SECONDS})[0]:
    if not os.read(0, 1):
        sys.exit()
os.kill(int(sys.argv[1]), signal.SIGKILL)
"""


def _exit_on_signal() -> None:
    """Make SIGINT and SIGTERM end this process within `_ENDING_SECONDS`, regardless of what its threads do."""
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    command = [sys.executable, "-I", "-S", "-c", _WATCH, str(os.getpid())]
    subprocess.Popen(command, stdin=reads, start_new_session=True)
    os.close(reads)
    signal.set_wakeup_fd(writes, warn_on_full_buffer=False)
