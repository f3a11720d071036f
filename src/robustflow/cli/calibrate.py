"""`robustflow calibrate`: measure the severities at which corruptions can be compared."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Corruptions, Seed, names


def calibrate(
    data: Annotated[
        Path | None, typer.Option("--data", "-d", help="Folder of pictures instead of scikit-image's photographs.")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the table (JSON).")] = None,
    corruptions: Corruptions = None,
    seed: Seed = 0,
    draws: Annotated[int, typer.Option(help="Draws of a random corruption per picture.")] = 4,
) -> None:
    """Find the parameters at which every corruption leaves the same mean SSIM (docs/severity-scales.md).

    Takes a quarter of an hour for all corruptions on the reference set. With --corruptions, an existing --output made
    with the same pictures, seed and draws keeps its other corruptions. ROBUSTFLOW_CALIBRATION=FILE replaces the shipped
    table with your own.

    \b
    Examples:
      robustflow calibrate --seed 0 --output calibrated.json
      robustflow calibrate --data ~/frames --corruptions fog,contrast --output mine.json
    """
    from ..atomic import write_json
    from ..corruptions.calibration.search import calibratable, reference_pictures
    from ..corruptions.calibration.search import calibrate as measure
    from ..corruptions.scale import CalibratedCorruption, merged_tables, read_table, shipped
    from ..sealed import sealed

    def show(name: str, result: CalibratedCorruption) -> None:
        low, high = result.reachable
        levels = " ".join("    -" if level.parameter is None else f"{level.ssim:.3f}" for level in result.levels)
        typer.echo(f"{name:20s} {levels}   reaches {low:.3f} to {high:.3f}")

    table = measure(names(corruptions) or calibratable(), reference_pictures(data), seed, draws, report=show)
    if output is not None:
        if corruptions is not None and output.exists():
            table = merged_tables(read_table(output), table)
        write_json(output, sealed(table.model_dump(mode="json")))
        typer.echo(str(output))
    elif data is None and (seed, draws) == (shipped().seed, shipped().draws):
        same = all(shipped().corruptions.get(name) == result for name, result in table.corruptions.items())
        typer.echo("as shipped, digit for digit" if same else "differs from the shipped table")
