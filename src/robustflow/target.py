"""`module.path:Attribute`: import what a user names on the command line."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from .errors import RobustFlowError, UsageError, unknown_name


def is_target(text: str) -> bool:
    """Whether a text has the form `module.path:Attribute`.

    >>> is_target("mypkg.data:MySet"), is_target("kitti-fc"), is_target("C:/data"), is_target("data/clip.mp4")
    (True, False, False, False)
    """
    module, colon, attribute = text.partition(":")
    return bool(colon) and all(name.isidentifier() for name in f"{module}.{attribute}".split("."))


def import_target(target: str, kind: str, error: type[RobustFlowError] = UsageError) -> Any:
    """The attribute of a module that is installed or in the working folder.

    Args:
        kind: what it should be, for messages.
        error: raised where the module cannot be imported.

    Raises:
        UsageError: the module has no such attribute.

    >>> import_target("json:loads", "data set")("[1]")
    [1]
    """
    name, _, attribute = target.partition(":")
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)  # a console script does not see the user's folder; `python -m` would
    try:
        value: Any = import_module(name)
    except (
        Exception,
        SystemExit,
    ) as cause:  # SystemExit: a script that reads its arguments on import
        raise error(
            f"cannot import '{name}' for {kind} '{target}': {type(cause).__name__}: {cause}; "
            "run from the folder that holds it, or install its package"
        ) from cause
    for part in attribute.split("."):
        if not hasattr(value, part):
            raise unknown_name(f"attribute of {name}", part, [key for key in vars(value) if key[0] != "_"])
        value = getattr(value, part)
    return value


def source_of_target(target: str) -> bytes | None:
    """The source file of the module that a target names; None where it was not imported, or comes from no file.

    >>> source_of_target("json:loads") is not None, source_of_target("sys:path")
    (True, None)
    """
    path = getattr(sys.modules.get(target.partition(":")[0]), "__file__", None)
    return Path(path).read_bytes() if path else None
