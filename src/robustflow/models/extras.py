"""The optional libraries that models and commands need."""

from __future__ import annotations

from importlib.util import find_spec

from ..errors import ModelError


def require(library: str, extra: str, needing: str) -> None:
    """Raise an error that names the extra to install if a library is not installed.

    Args:
        library: the module to import.
        extra: the one of this package that installs it.
        needing: what needs it, as the message's subject.

    >>> require("numpy", "none", "model 'dis'")

    Raises:
        ModelError: the library is not installed.
    """
    if find_spec(library) is None:
        title = "PyTorch" if library == "torch" else library
        raise ModelError(
            f"{needing} needs {title}, which is not installed: pip install 'robustflow[{extra}]' "
            "(with -c constraints.txt from a checkout)"
        )
