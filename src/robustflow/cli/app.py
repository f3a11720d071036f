"""`robustflow app`: explore a pair under corruptions interactively in a browser."""

from typing import Annotated, Any

from typer import Option

from ..core.plugins import require
from .interrupt import terminate_as_on_ctrl_c
from .options import MODEL, model_ref, shared


@shared(*MODEL, "psf_dir")
def app(
    host: Annotated[str | None, Option(help="Address to listen on; by default only this machine can reach it.")] = None,
    port: Annotated[int | None, Option(help="Port to listen on; 8642 by default, or any free port.")] = None,
    browser: Annotated[bool, Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    **given: Any,
) -> None:
    """Choose a pair, a model and corruptions in the browser, and see how the frames, the flow and its errors change.

    By default the page is served on this machine only. Its URL contains an access token. Press Ctrl-C to stop.

    \b
    Examples:
      robustflow app --model raft --checkpoint things --device cuda
      robustflow app --model mypackage.flow:MyModel --no-browser --port 9000
    """
    for library in ("starlette", "uvicorn", "python_multipart"):
        require(library, "the app")
    from ..app.serve import serve

    terminate_as_on_ctrl_c()  # so that the uploads are removed
    ref = model_ref(given)
    serve([] if ref is None else [ref], host, port, browser)
