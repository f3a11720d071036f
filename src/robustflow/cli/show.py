"""`robustflow show`: print the tables of a run, finished or not."""

from pathlib import Path
from typing import Annotated

import typer


def show(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder or record.")],
    metric: Annotated[
        str,
        typer.Option(
            "--metric",
            help="epe, cre, crer, rcre, rcre_all, fl, px1, px3, px5, wauc, photometric, coverage, spread; less "
            "dependent on accuracy: log_ratio, median_log_ratio, median_cre, fl_increase; or all.",
        ),
    ] = "all",
    as_json: Annotated[bool, typer.Option("--json", help="Print name, benchmark, folder and summary as JSON.")] = False,
) -> None:
    """Print a run's tables and update its summary and report; a record is only printed.

    \b
    Examples:
      robustflow show runs/demo_dis_1a2b3c4d --metric rcre
      robustflow show runs/demo_dis_1a2b3c4d --metric log_ratio
      robustflow show colleague.robustflow
    """
    import warnings

    from ..errors import DataError
    from ..records.load import load_any_run
    from ..report.site.write import write_report
    from .tables import as_json_text, print_result

    result, in_folder = load_any_run(run), run.is_dir()
    if in_folder:
        try:
            result.write_means()
            write_report(result)
        except DataError as error:
            in_folder = False
            warnings.warn(f"the summary and the report were not updated: {error}", stacklevel=1)
    if as_json:
        typer.echo(as_json_text([result]))
    else:
        print_result(result, metric, report=in_folder)
