"""HTTP connections that must send their request headers within a few seconds.

uvicorn waits for a request's headers for as long as the connection stays open. A few half-sent requests would then use
up the connections that the server allows, and the page would no longer be answered.
"""

from __future__ import annotations

import asyncio
from typing import Any, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_SECONDS = 10.0
"""Seconds a client has to send its headers, from its first byte or from opening the connection."""


class TimedProtocol(H11Protocol):
    """uvicorn's protocol, which closes a connection whose headers do not come in time."""

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See uvicorn."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """See uvicorn."""
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """See uvicorn."""
        self._forget()
        super().connection_lost(exc)

    def _watch(self) -> None:
        """Start the timer when headers are awaited, and stop it when they have arrived."""
        cycle = cast(Any, self.cycle)
        if cycle is not None and not cycle.response_complete:
            self._forget()
        elif self._late is None:
            self._late = self.loop.call_later(HEADER_SECONDS, self._close)

    def _forget(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _close(self) -> None:
        self._late = None
        cycle = cast(Any, self.cycle)
        if cycle is None or cycle.response_complete:
            self.transport.abort()
