"""`robustflow check`: test your own model, corruption, attack or dataset before a run."""

from typing import Annotated, Any

import typer

from ..core.errors import UsageError

KINDS = ("model", "corruption", "attack", "dataset")


def check(
    target: Annotated[str, typer.Argument(metavar="MODULE:ATTRIBUTE", help="Class, object or function to test.")],
    kind: Annotated[
        str | None, typer.Option(help="model, corruption, attack or dataset; detected from its methods by default.")
    ] = None,
) -> None:
    """Test your own model, corruption, attack or dataset: shapes, dtypes, determinism, unmodified inputs.

    \b
    Examples:
      robustflow check mypackage.flow:MyModel
      robustflow check mypackage.rain:Rain
      robustflow check mypackage.climb:Climb
      robustflow check mypackage.data:MyPairs --kind dataset
    """
    from ..core.plugins import called, import_target, needed_options
    from ..core.text import plain
    from ..testing import check_attack, check_corruption, check_dataset, check_model

    if kind not in (None, *KINDS):
        raise UsageError(f"--kind {kind}: choose from {', '.join(KINDS)}")
    thing = import_target(target, kind or "check")
    kind = kind or _kind(thing)
    if isinstance(thing, type):
        if missing := needed_options(thing):
            raise UsageError(
                f"{target} needs the option {missing[0]}, which check cannot pass: give it a default value, or check "
                "an object made with it"
            )
        if kind in ("model", "dataset"):
            thing = called(f"{target} failed in its construction", thing)
    if kind == "corruption":
        name = check_corruption(thing)
    elif kind == "attack":
        name = check_attack(thing)
    elif kind == "dataset":
        name = check_dataset(thing)
    else:
        name = check_model(thing)
    typer.echo(f"{kind} '{plain(name)}': all checks passed")


def _kind(thing: Any) -> str:
    if hasattr(thing, "draw") and hasattr(thing, "apply"):
        return "corruption"
    if hasattr(thing, "run") and not hasattr(thing, "predict"):
        return "attack"
    return "dataset" if hasattr(thing, "keys") and hasattr(thing, "load") else "model"
