"""`robustflow check`: test your own model, corruption, attack or dataset before a run."""

from inspect import isroutine
from typing import Annotated, Any

from typer import Argument, Option

from ..core.errors import UsageError, unknown_name
from ..core.output import echo
from ..core.plugins import called, import_target, needed_options
from ..core.text import plain


def check(
    target: Annotated[str, Argument(metavar="MODULE:ATTRIBUTE", help="Class, object or function to test.")],
    kind: Annotated[str | None, Option(help="model, corruption, attack or dataset; detected by default.")] = None,
) -> None:
    """Test your own model, corruption, attack or dataset: shapes, dtypes, determinism, unmodified inputs.

    \b
    Examples:
      robustflow check mypackage.flow:MyModel
      robustflow check mypackage.data:MyPairs --kind dataset
    """
    from ..models.loading import takes_two_frames
    from ..testing import check_attack, check_corruption, check_dataset, check_model

    checks = {"model": check_model, "corruption": check_corruption, "attack": check_attack, "dataset": check_dataset}
    if kind is not None and kind not in checks:
        raise unknown_name("kind", kind, checks)
    thing: Any = import_target(target, kind or "check")
    kind = kind or _kind(thing)
    is_factory = kind == "model" and isroutine(thing) and not takes_two_frames(thing)
    if isinstance(thing, type) or is_factory:
        if missing := needed_options(thing):
            raise UsageError(
                target,
                f"needs the option {missing[0]}, which check cannot pass: give a default value, or check an object",
            )
        if kind in ("model", "dataset"):
            thing = called(target, "building it", thing)
    echo(f"{kind} '{plain(checks[kind](thing))}': all checks passed")


def _kind(thing: Any) -> str:
    if hasattr(thing, "draw") and hasattr(thing, "apply"):
        return "corruption"
    if hasattr(thing, "run") and not hasattr(thing, "predict"):
        return "attack"
    return "dataset" if hasattr(thing, "keys") and hasattr(thing, "load") else "model"
