"""`module.path:Attribute`: what a user names on the command line, imported."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from .errors import UsageError, unknown_name


def is_target(text: str) -> bool:
    """Whether a text means `module.path:Attribute`.

    >>> is_target("mypkg.data:MySet"), is_target("kitti-fc"), is_target("C:/data"), is_target("data/clip.mp4")
    (True, False, False, False)
    """
    module, colon, attribute = text.partition(":")
    return bool(colon) and all(name.isidentifier() for name in f"{module}.{attribute}".split("."))


def import_target(target: str, kind: str) -> Any:
    """The attribute of a module that is installed, or is in the working folder.

    Args:
        kind: what it is to be, for messages.

    Raises:
        UsageError: it cannot be imported, or has no such attribute.

    >>> import_target("json:loads", "data set")("[1]")
    [1]
    """
    name, _, attribute = target.partition(":")
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)  # a console script does not see the user's folder; `python -m` would
    try:
        value: Any = import_module(name)
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"cannot import '{name}' for {kind} '{target}': {type(error).__name__}: {error}; "
            "run from the folder that holds it, or install its package"
        ) from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            raise unknown_name(f"attribute of {name}", part, [key for key in vars(value) if key[0] != "_"])
        value = getattr(value, part)
    return value
