"""Accept requests to the app only from this session's page.

Every page in the same browser can reach a web server on loopback. Three checks reject other pages: the Host header must
name this server (a foreign domain may resolve to 127.0.0.1), a POST must come from a page of this server (Origin), and
every request for more than the page's own files needs the session's token. The token is part of the address printed in
the terminal; the page keeps it in its tab and sends it as a header. A cookie would also be sent to servers on other
ports.
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections.abc import Container

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
