"""`robustflow record`: pack a run into one file that can be shared, and verify such files."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..core.output import echo
from ..core.text import plain
from .options import DATASET, DEPTH, data_options, model_ref, refuse_unused, shared

if TYPE_CHECKING:
    from ..models import ModelRef
    from ..run.records.read import Reader
    from ..run.records.verify import Verification

app = typer.Typer(no_args_is_help=True)


@app.command()
@shared(output="Output file, NAME.robustflow; named after the folder by default.")
def pack(
    run: Annotated[Path, Argument(metavar="RUN", help="A run's folder.")],
    author: Annotated[str, Option(help="Submitter of the record.")] = "",
    link: Annotated[str, Option(help="URL with more information: https://...")] = "",
    description: Annotated[str, Option(help="Description in one or two sentences, plain text.")] = "",
    partial: Annotated[bool, Option("--partial", help="Pack an unfinished run; the record is marked as such.")] = False,
    keep_paths: Annotated[bool, Option("--keep-paths", help="Allow texts that contain paths on this machine.")] = False,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace a file that is no record of this run.")] = False,
    **given: Any,
) -> None:
    """Pack a run into one file that another machine can verify and add to its leaderboard.

    The record contains the manifest and the rows of the run, but no images, command lines, paths or machine names.
    Packing is deterministic.

    \b
    Example:
      robustflow record pack runs/mine -o mine.robustflow --author "A. Author" --link https://example.org/mine
    """
    from ..run.records.pack import pack as pack_run
    from ..run.run import Run

    texts = {"author": author, "link": link, "description": description}
    path = pack_run(Run(run), given["output"], **texts, partial=partial, keep_paths=keep_paths, overwrite=overwrite)
    echo(plain(str(path), None))


@app.command()
@shared(
    *("data_options", *DEPTH, "checkpoint", "device", "option", "own_corruption"),
    data="Your copy of the data; corrupted frames are recomputed and compared.",
    model="With --data: model of the run; some rows are predicted again and compared.",
    as_json="Print the checks as JSON.",
)
def verify(
    context: typer.Context,
    files: Annotated[list[Path], Argument(metavar="FILE", help="Records written by 'robustflow record pack'.")],
    check_frames: Annotated[int | None, Option(metavar="N", help="Number of rows to compare [20].")] = None,
    seed: Annotated[int | None, Option(help="Random seed of the choice of rows; random by default.")] = None,
    exported: Annotated[
        list[Path] | None,
        Option(help="File of 'robustflow export' (not Parquet) to compare with the record. Repeatable."),
    ] = None,
    **given: Any,
) -> None:
    """Check records: the file, the plan and the rows, from which the means are computed.

    With --data, everything except the prediction is recomputed for random rows: the input frames, byte for byte, and
    the values that depend on the ground truth. With --model as well, the same rows are predicted again. Exit codes: 0
    if all checks of all files pass, 1 if not.

    \b
    Examples:
      robustflow record verify submissions/*.robustflow
      robustflow record verify mine.robustflow --data ~/kitti --check-frames 100 --model dis
      robustflow record verify mine.robustflow --exported rows.csv
    """
    import json

    from ..report.exchange import check_exported
    from ..run.records.verify import verify as verify_file

    ref, count = model_ref(given), 20 if check_frames is None else check_frames
    compare = partial(_compare_rows, data=given["data"], options=data_options(given), count=count, seed=seed)
    frames = compare if given["data"] is not None or check_frames is not None or ref is not None else None
    if frames is None:
        unused = {"seed", "own_corruption", *DATASET}
        refuse_unused(context, unused, "without --data, --model or --check-frames")
    predictions = None if ref is None else partial(compare, model=ref)
    compare_exported = partial(check_exported, paths=exported) if exported else None
    results = [verify_file(path, frames=frames, predictions=predictions, exported=compare_exported) for path in files]
    if given["as_json"]:
        echo(json.dumps([{"ok": result.ok, **result.model_dump()} for result in results], indent=2))
    else:
        for result in results:
            _print(result)
    if not all(result.ok for result in results):
        raise typer.Exit(1)


def _compare_rows(reader: "Reader", data: Path | None, model: "ModelRef | None" = None, **options: Any) -> str:
    """Compare rows with recomputed frames, and with predictions if a model is given. Rows of attacks are skipped
    because their frames depend on the model."""
    import polars as pl

    from ..run.repeat import recheck

    rows = reader.frame.filter(~pl.col("corruption").is_in(list(reader.attacks)))
    return recheck(reader.plan.identity, rows, data, model=model, **options)


def _print(result: "Verification") -> None:
    from ..run.records.verify import CHECKS, CHECKS_ON_REQUEST

    container, *others = result.checks
    if container.status == "failed" and not any(check.status == "ok" for check in others):
        echo(f"not verified: {plain(container.message, None)}")  # not a record, so there are no further checks
        return
    echo(plain(result.file, 200))
    descriptions = {name: words for name, (words, _) in CHECKS.items()} | CHECKS_ON_REQUEST
    for check in result.checks:
        about = f"{descriptions[check.name]}{f': {check.message}' if check.message else ''}"
        echo(f"  {check.status:11s}  {check.name:12s}  {about}")
    stated = result.facts.model_dump(include={"author", "link", "description"}) if result.facts else {}
    for name, text in stated.items():
        if text:
            echo(f"  {name}: {plain(text, None)}")
    verdict = "verified" if result.ok else "not verified"
    echo(f"  {verdict}{f', SHA-256 {result.sha256}' if result.sha256 else ''}")
    if result.ok and result.subject is not None:
        echo(f"  {result.subject.sentence}")
        for claim in result.unproven:
            echo(f"  not proven: {claim}")
