"""`robustflow show`: a run again, finished or not."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def show(
    run: Annotated[Path, typer.Argument(help="A run's folder.")],
    metric: Annotated[str, typer.Option("--metric", help="epe, cre, rcre, or all.")] = "all",
) -> None:
    """Print a run's tables again, and write its summary and report anew.

    \b
    Example:
      robustflow show runs/demo_dis_1a2b3c4d --metric rcre
    """
    from ..runner.result import Result
    from .tables import print_result

    result = Result(run)
    result.write_summary()
    print_result(result, metric)
