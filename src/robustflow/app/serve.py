"""Start the app's server, print its address, and end with Ctrl-C."""

from __future__ import annotations

import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable, Sequence
from types import FrameType

import uvicorn

from ..errors import UsageError
from ..models import ModelSpec
from .choices import Models
from .ending import end_after_signal
from .guard import Guard
from .pairs import SourceStore
from .prediction_queue import PredictionQueue
from .protocol import TimedProtocol
from .server import build
from .upload_folder import UploadFolder

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8642


def serve(
    given: Sequence[ModelSpec],
    host: str | None = None,
    port: int | None = None,
    browser: bool = True,
    say: Callable[[str], None] = print,
    warn: Callable[[str], None] = print,
) -> None:
    """Serve until interrupted.

    Args:
        given: models to offer before those that are installed; they are loaded on first use.
        host: to listen on; loopback by default.
        port: to listen on; 8642 by default, or a free one if that is taken. 0 takes any free one.
        browser: whether to open the page.
        say, warn: take one line.

    Raises:
        UsageError: an address or port that cannot be listened on.
    """
    listening = _listen(host or LOOPBACK, port)
    number = listening.getsockname()[1]
    others = not _is_loopback(listening.getsockname()[0])
    if others:
        warn("anyone who can reach this machine and knows the address can use this app and what it loads")
    token = secrets.token_urlsafe(24)
    shown = f"[{host}]" if host and ":" in host else host or LOOPBACK
    address = f"http://{LOOPBACK if shown in ('0.0.0.0', '[::]') else shown}:{number}/?token={token}"
    sources, queue, uploads = SourceStore(), PredictionQueue(), UploadFolder()
    guarded = Guard(build(Models(given), sources, queue, uploads), token, number, (host or "") if others else "")
    config = uvicorn.Config(
        guarded,
        http=TimedProtocol,
        log_level="error",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="none",
        proxy_headers=False,
        limit_concurrency=64,
        timeout_graceful_shutdown=1,
    )
    say(f"robustflow app: {address} (Ctrl-C ends)")
    if browser:
        threading.Timer(0.5, webbrowser.open, (address,)).start()
    try:
        end_after_signal()
        _Server(config, queue).run(sockets=[listening])
    except KeyboardInterrupt:
        pass  # the intended end of this server
    finally:
        listening.close()
        sources.close()
        uploads.close()


class _Server(uvicorn.Server):
    """A server that does not wait for a prediction when it should end."""

    def __init__(self, config: uvicorn.Config, queue: PredictionQueue) -> None:
        super().__init__(config)
        self._desk = queue

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """See uvicorn."""
        self._desk.close()
        super().handle_exit(sig, frame)


def _listen(host: str, port: int | None) -> socket.socket:
    """A socket on the requested port; on any port if none was requested and the usual one is taken."""
    if port is not None and not 0 <= port <= 65535:
        raise UsageError(f"port {port} does not exist: give 1 to 65535, or 0 for any")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for number in (DEFAULT_PORT, 0) if port is None else (port,):
        listening = socket.socket(family, socket.SOCK_STREAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((host, number))
            listening.listen(64)
        except OSError as error:
            listening.close()
            reason = error.strerror or str(error)
            continue
        return listening
    raise UsageError(f"cannot listen on {host} port {number}: {reason}; give another --port or --host")


def _is_loopback(address: str) -> bool:
    return address == "::1" or address.startswith("127.")
