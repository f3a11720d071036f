"""The app's server: it accepts requests only from this session's page, and Ctrl-C stops it during a prediction.

Every page in the same browser can reach a web server on loopback. Three checks reject other pages: the Host header must
name this server (a foreign domain may resolve to 127.0.0.1), a POST must come from a page of this server (Origin), and
every request for more than the page's own files needs the session's token. The token is part of the address printed in
the terminal; the page keeps it in its tab and sends it as a header. A cookie would also be sent to servers on other
ports.
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import os
import secrets
import socket
import threading
import warnings
import webbrowser
from collections.abc import Container, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

import uvicorn
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..core.errors import UsageError
from ..core.output import echo
from ..models import ModelRef
from .models import Models
from .prediction_queue import PredictionQueue
from .routes import FILES, build
from .sources import SourceStore

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_SAFE = ("GET", "HEAD")


class Guard:
    """Middleware around the whole app."""

    def __init__(self, app: ASGIApp, token: str, port: int, public: Container[str], host: str = "") -> None:
        self._app = app
        self._token = token
        self._port = port
        self._hosts = {host.lower(), socket.gethostname().lower()} if host else set()
        self._public = public

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] != "http":
            return  # websockets are not supported; uvicorn closes unanswered connections

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers[name] = value
            await send(message)

        await (self._refusal(scope) or self._app)(scope, receive, with_headers)

    def _refusal(self, scope: Scope) -> Response | None:
        """Return the response that replaces the app's, or None."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._is_this_server(host):
            return _refused("this server only answers to its own address: use the one printed in the terminal", 421)
        if scope["method"] not in _SAFE and headers.get("origin") != f"http://{host}":
            return _refused("requests from other pages are rejected", 403)
        token = headers.get("x-token", "").encode()
        if scope["path"] not in self._public and not hmac.compare_digest(token, self._token.encode()):
            return _refused("open the address that robustflow app printed in the terminal; it contains a token", 403)
        return None

    def _is_this_server(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        if not port.isdigit():
            name, port = host, "80"  # browsers omit the default port
        if port != str(self._port):
            return False
        name = name.lower()
        if name in ("localhost", "127.0.0.1", "[::1]"):
            return True
        return bool(self._hosts) and (_is_address(name.strip("[]")) or name in self._hosts)


def _is_address(name: str) -> bool:
    """Return whether a host is a numeric address, which a foreign name server cannot control."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _refused(line: str, status: int) -> Response:
    return JSONResponse({"error": line}, status)


LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8642


def serve(given: Sequence[ModelRef], host: str | None = None, port: int | None = None, browser: bool = True) -> None:
    """Serve until interrupted."""
    models = Models(given)
    for ref in given:
        models.load_given(ref)
    listening = _listen(host or LOOPBACK, port)
    number = listening.getsockname()[1]
    others = not _is_loopback(listening.getsockname()[0])
    if others:
        warnings.warn(
            "anyone who can reach this machine and knows the address can use this app and the models that it loads",
            stacklevel=2,
        )
    token = secrets.token_urlsafe(24)
    shown = f"[{host}]" if host and ":" in host else host or LOOPBACK
    address = f"http://{LOOPBACK if shown in ('0.0.0.0', '[::]') else shown}:{number}/?token={token}"
    # a malformed upload is answered on the page; without a handler, its parser would also print to the terminal
    logging.getLogger("python_multipart").addHandler(logging.NullHandler())
    sources, queue = SourceStore(), PredictionQueue()
    with TemporaryDirectory(prefix="robustflow-app-", ignore_cleanup_errors=True) as uploads:
        app = build(models, sources, queue, Path(uploads))
        config = uvicorn.Config(
            Guard(app, token, number, FILES, (host or "") if others else ""),
            http="h11",
            log_level="error",
            access_log=False,
            server_header=False,
            lifespan="off",
            ws="none",
            proxy_headers=False,
            timeout_graceful_shutdown=1,
        )
        echo(f"robustflow app: {address} (press Ctrl-C to stop)")
        if browser:
            threading.Timer(0.5, webbrowser.open, (_redirect(Path(uploads), address).as_uri(),)).start()
        try:
            _Server(config, queue).run(sockets=[listening])
        except KeyboardInterrupt:
            pass  # the normal way to stop this server
        finally:
            listening.close()
            sources.close()


class _Server(uvicorn.Server):
    """A server that does not wait for a prediction when it is stopped."""

    def __init__(self, config: uvicorn.Config, queue: PredictionQueue) -> None:
        super().__init__(config)
        self._queue = queue

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
        raise UsageError("--port", f"{port} is out of range: give 1 to 65535, or 0 for any")
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
    raise UsageError(
        "--host", f"cannot listen on {host} port {number}: {reason}; choose a different one, or a different port"
    )


def _is_loopback(address: str) -> bool:
    return address == "::1" or address.startswith("127.")
