"""The optional libraries a model needs."""

from __future__ import annotations

from importlib.util import find_spec

from ..errors import ModelError


def require(library: str, extra: str, model: str) -> None:
    """Raise an error that names the extra a model needs if its library is not installed.

    >>> require("numpy", "none", "dis")

    Raises:
        ModelError: the library is not installed.
    """
    if find_spec(library) is None:
        title = "PyTorch" if library == "torch" else library
        raise ModelError(
            f"model '{model}' needs {title}, which is not installed: pip install 'robustflow[{extra}]' "
            "(with -c constraints.txt from a checkout)"
        )
