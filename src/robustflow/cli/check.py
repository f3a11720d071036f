"""`robustflow check`: test your own model, corruption, attack or dataset before a run."""

from functools import partial
from inspect import isroutine
from typing import Annotated, Any

from typer import Argument, Option

from ..core.errors import UsageError, unknown_name
from ..core.output import echo
from ..core.plugins import called, check_options, import_target, is_target
from ..core.text import plain
from .advice import kind_of
from .options import keyword_options, shared


@shared(option="Option of the model or dataset, e.g. preset=fast. Repeatable.")
def check(
    target: Annotated[
        str, Argument(metavar="MODULE:ATTRIBUTE", help="Class, object or function to test, or a registered name.")
    ],
    kind: Annotated[str | None, Option(help="model, corruption, attack or dataset; detected by default.")] = None,
    **given: Any,
) -> None:
    """Test your own model, corruption, attack or dataset: shapes, dtypes, determinism, unmodified inputs.

    \b
    Examples:
      robustflow check mypackage.flow:MyModel
      robustflow check mypackage.data:MyPairs --kind dataset
      robustflow check raft -O checkpoint=raft-things.pth
    """
    from ..models.loading import load_model
    from ..models.objects import as_model, takes_two_frames
    from ..testing import check_attack, check_corruption, check_dataset, check_model

    checks = {"model": check_model, "corruption": check_corruption, "attack": check_attack, "dataset": check_dataset}
    if kind is not None and kind not in checks:
        raise unknown_name("kind", kind, checks)
    options = dict(keyword_options(given["option"]))
    named = "" if is_target(target) else kind_of(target)
    if named in ("model", "file"):
        thing: Any = load_model(target, **options)
        kind, options = kind or "model", {}
    elif named in ("corruption", "attack"):
        thing, kind = target, kind or named
    else:
        thing = import_target(target, kind or "class, object or function")
        kind = kind or _kind(thing)
        is_factory = kind == "model" and isroutine(thing) and not takes_two_frames(thing)
        if isinstance(thing, type) or is_factory:
            check_options(thing, f"{kind} '{target}'", options, "-O")
            if kind in ("model", "dataset"):
                make = partial(thing, **options)
                thing, options = called(target, "building it", make), {}
        if kind == "model":
            thing = as_model(thing, target)
    if options:
        raise UsageError("--option", "only a model or dataset that check constructs has options; leave it out")
    echo(f"{kind} '{plain(checks[kind](thing))}': all checks passed")


def _kind(thing: Any) -> str:
    if hasattr(thing, "draw") and hasattr(thing, "apply"):
        return "corruption"
    if hasattr(thing, "run") and not hasattr(thing, "predict"):
        return "attack"
    return "dataset" if hasattr(thing, "keys") and hasattr(thing, "load") else "model"
