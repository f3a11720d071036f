"""The optional libraries that models, readers and commands need."""

from __future__ import annotations

from importlib.util import find_spec

from .errors import AssetError

EXTRAS = {
    "torch": "torch",
    "torchvision": "torch",
    "ptlflow": "ptlflow",
    "onnx": "onnx",
    "onnxruntime": "onnx",
    "ray": "ray",
    "h5py": "h5",
    "starlette": "app",
    "uvicorn": "app",
    "python_multipart": "app",
}
"""Mapping from a module to the extra of this package that installs it."""

_TITLES = {"torch": "PyTorch", "ray": "Ray"}


def require(library: str, needing: str) -> None:
    """Raise an error that names the required extra if a library is not installed."""
    if find_spec(library) is None:
        raise AssetError(
            f"{needing} needs {_TITLES.get(library, library)}, which is not installed: {install_command(library)} "
            "(with -c constraints.txt from a checkout)"
        )


def install_command(library: str) -> str:
    """Return the command that installs a library of `EXTRAS`.

    >>> install_command("onnxruntime")
    "pip install 'robustflow[onnx]'"
    """
    return f"pip install 'robustflow[{EXTRAS[library]}]'"
