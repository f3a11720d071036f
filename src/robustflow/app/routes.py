"""The app's routes: the page and its three files, the available choices, uploads, and previews as a stream of lines."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from functools import partial
from importlib.resources import files
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from ..core.errors import RobustFlowError, first_misfit
from ..corruptions.registry import CLIP, CORRUPTIONS, FAMILIES, PAPER_ORDER
from ..media.colours import HIGHEST, LOWEST, error_colours, flow_colours
from ..media.images import png_address
from .models import Models
from .prediction_queue import Message, PredictionQueue, QueuedPrediction
from .preview import Previewer, PreviewRequest
from .sources import DEMO, SourceStore
from .uploads import MAX_BYTES, limited, source_of

_MAX_REQUEST = 2**14
FILES = {
    "/": ("app.html", "text/html"),
    "/app.css": ("app.css", "text/css"),
    "/app.js": ("app.js", "text/javascript"),
    "/results.js": ("results.js", "text/javascript"),
}
"""The page's files by path."""
_END = ("result", "error", "outdated")


def build(models: Models, sources: SourceStore, queue: PredictionQueue, uploads: Path) -> Starlette:
    """Return the app without its guard."""
    previewer = Previewer(sources, models)

    async def choices(request: Request) -> Response:
        return JSONResponse(_choices(models, sources))

    async def upload(request: Request) -> Response:
        async with limited(request, MAX_BYTES).form(max_files=3, max_fields=0) as form:
            source = await run_in_threadpool(source_of, form, Path(mkdtemp(dir=uploads)))
        return JSONResponse({"source": sources.add(source), "name": source.name, "pairs": source.pairs})

    async def preview(request: Request) -> Response:
        preview_request = PreviewRequest.model_validate_json(await limited(request, _MAX_REQUEST).body())
        models.check(preview_request.model, preview_request.checkpoint)
        sources.get(preview_request.source)
        messages: asyncio.Queue[Message] = asyncio.Queue()
        loop = asyncio.get_running_loop()

        def tell(message: Message) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(messages.put_nowait, message)

        job = QueuedPrediction(preview_request.page, partial(previewer.preview, preview_request), tell)
        queue.submit(job)
        return StreamingResponse(_lines(job, messages), media_type="application/x-ndjson")

    pages = [Route(path, partial(_file, *file)) for path, file in FILES.items()]
    routes = [
        Route("/choices", choices),
        Route("/upload", upload, methods=["POST"]),
        Route("/preview", preview, methods=["POST"]),
    ]
    handlers: dict[Any, Any] = {
        RobustFlowError: _refused,
        ValidationError: _refused,
        MultiPartException: _refused,
        HTTPException: _refused,
        ClientDisconnect: _refused,  # the page was closed while it sent
        Exception: _failed,
    }
    return Starlette(routes=[*pages, *routes], exception_handlers=handlers)


async def _file(name: str, kind: str, request: Request) -> Response:
    return Response((files("robustflow.app") / "assets" / name).read_bytes(), media_type=f"{kind}; charset=utf-8")


async def _lines(job: QueuedPrediction, messages: asyncio.Queue[Message]) -> AsyncIterator[bytes]:
    """Yield every message of a job as a line of JSON; if the page disconnects, the job becomes outdated."""
    try:
        while True:
            message = await messages.get()
            yield json.dumps(message, allow_nan=False).encode() + b"\n"
            if any(name in message for name in _END):
                return
    finally:
        job.outdated.set()


async def _refused(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 400
    if isinstance(error, ValidationError):
        line = first_misfit(error, "the request")
    elif isinstance(error, HTTPException):
        line = error.detail
    else:
        line = str(error)
    return JSONResponse({"error": " ".join(line.split())}, status)


async def _failed(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": f"the app failed ({type(error).__name__}); see its terminal"}, 500)


def _choices(models: Models, sources: SourceStore) -> dict[str, Any]:
    """Return the choices that the page offers."""
    families = {family: [name for name in names if name not in CLIP] for family, names in FAMILIES.items()}
    others = [name for name in CORRUPTIONS.names() if name not in (*PAPER_ORDER, *CLIP)]
    scale = np.geomspace(LOWEST, HIGHEST, 300)[None].repeat(12, 0)
    side = np.linspace(-1, 1, 120, dtype=np.float32)
    wheel = np.stack(np.meshgrid(side, side), axis=2)
    return {
        "models": models.offers,
        "families": {family: names for family, names in (families | {"other": others}).items() if names},
        "demo": {"source": DEMO, "name": sources.get(DEMO).name, "pairs": 1},
        "max_bytes": MAX_BYTES,
        "error_scale": png_address(error_colours(scale)),
        "wheel": png_address(flow_colours(wheel, 1.0)),
    }
