"""`robustflow calibrate`: find severities that are comparable across corruptions."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Corruptions, Seed, names


def calibrate(
    data: Annotated[
        Path | None, typer.Option("--data", "-d", help="Folder of images to use instead of scikit-image's photographs.")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write the table to (JSON).")] = None,
    corruptions: Corruptions = None,
    seed: Seed = 0,
    draws: Annotated[int, typer.Option(help="Number of random draws per image, for random corruptions.")] = 4,
) -> None:
    """Find the parameters at which all corruptions have the same mean SSIM (docs/severity-scales.md).

    Calibrating all corruptions on the reference set takes 15 minutes. With --corruptions, other corruptions in an
    existing --output are kept if images, seed and draws are the same. Set ROBUSTFLOW_CALIBRATION=FILE to use your own
    table instead of the shipped one.

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
        typer.echo("identical to the shipped table" if same else "differs from the shipped table")
