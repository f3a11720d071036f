"""`robustflow app`: explore a pair under corruptions interactively in a browser."""

import sys
from typing import Annotated

import typer

from ..core.errors import UsageError, plain_warning
from ..core.plugins import require
from .complete import terminate_as_on_ctrl_c
from .options import Checkpoint, Device, ModelOptions, Precision, PsfDir, model_options, use_psf_dir


def app(
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="Model listed first, e.g. module.path:Attribute.")
    ] = None,
    checkpoint: Checkpoint = None,
    device: Device = None,
    precision: Precision = None,
    option: ModelOptions = None,
    psf_dir: PsfDir = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; 127.0.0.1 by default, which only this machine can reach.")
    ] = None,
    port: Annotated[
        int | None, typer.Option(help="Port to listen on; by default 8642, or any free port if 8642 is in use.")
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
) -> None:
    """Choose a pair, a model and corruptions in the browser, and see how the frames, the flow and its errors change.

    By default the page is served on this machine only. Its URL contains an access token. Press Ctrl-C to stop.

    \b
    Examples:
      robustflow app
      robustflow app --model raft --checkpoint things --device cuda
      robustflow app --model mypackage.flow:MyModel --no-browser --port 9000
    """
    for library in ("starlette", "uvicorn", "python_multipart"):
        require(library, "the app")
    from ..app.serve import serve
    from ..models import ModelSpec

    use_psf_dir(psf_dir)
    terminate_as_on_ctrl_c()  # so that the uploads are removed
    options = model_options(option, checkpoint=checkpoint, device=device, precision=precision)
    if options and model is None:
        raise UsageError(f"{options[0][0]} is a model option: give the model with --model")
    specs = [] if model is None else [ModelSpec(model, options)]
    serve(specs, host, port, browser, lambda line: print(line, flush=True), _warn)


def _warn(line: str) -> None:
    print(plain_warning(line), end="", file=sys.stderr, flush=True)
