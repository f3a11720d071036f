"""`robustflow examples`: draw example pictures of a finished run."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Checkpoint,
    Data,
    DataOptions,
    Depth,
    Device,
    Focal,
    ModelOptions,
    OwnAttacks,
    OwnCorruptions,
    Precision,
    PsfDir,
    data_options,
    model_options,
    use_own_attacks,
    use_own_corruptions,
    use_psf_dir,
)


def examples(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.")],
    sample: Annotated[str | None, typer.Option("--sample", help="Draw only this sample, as a PNG file.")] = None,
    corruption: Annotated[
        str | None,
        typer.Option(
            "--corruption",
            "--corruptions",
            "-c",
            "--attack",
            "--attacks",
            help="With --sample: name of the corruption or attack.",
        ),
    ] = None,
    severity: Annotated[int | None, typer.Option("--severity", "--severities", "-s", help="With --sample.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="PNG file for --sample.")] = None,
    data: Data = None,
    data_option: DataOptions = None,
    depth: Depth = None,
    focal: Focal = None,
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="Model of the run, if the run does not record it.")
    ] = None,
    checkpoint: Checkpoint = None,
    device: Device = None,
    precision: Precision = None,
    option: ModelOptions = None,
    own_corruption: OwnCorruptions = None,
    own_attack: OwnAttacks = None,
    psf_dir: PsfDir = None,
) -> None:
    """Draw the worst and the median sample of a run: frames, corrupted frames, flows and error maps.

    The model and the data are read from where they were during the run; if they have moved, use the options. If the
    model is your own code (module:Attribute) or a file, give it with --model or --checkpoint: for safety, nothing is
    loaded just because it is named in a run's folder. The pictures are written to RUN/examples and RUN/report.html.

    \b
    Examples:
      robustflow examples runs/demo_dis_1a2b3c4d
      robustflow examples RUN --data /mnt/kitti
      robustflow examples RUN --sample 000010_10 --corruption fog --severity 3 -o fog.png
      robustflow examples RUN --sample 000010_10 --attack pgd --severity 3 -o pgd.png
    """
    from ..atomic import write_bytes
    from ..errors import UsageError
    from ..models import ModelSpec
    from ..report.site.write import write_report
    from ..runner.examples import draw_example, write_examples
    from ..runner.setup import restore_setup
    from ..runs.example_list import FOLDER
    from ..runs.run import Run
    from ..runs.source import RunSource
    from ..runs.store import RunFolder

    use_psf_dir(psf_dir)
    use_own_corruptions(own_corruption)
    named_attacks = use_own_attacks(own_attack)
    result = Run(run)
    cell = (sample, corruption, severity)
    if any(part is not None for part in cell) and None in cell:
        raise UsageError("a single picture needs --sample KEY, --corruption NAME and --severity N")
    if sample is None and output is not None:
        raise UsageError(
            f"--output is the PNG file for --sample; without --sample the examples are written to "
            f"{result.path / FOLDER}"
        )
    before = RunSource.read(result.path)
    options = model_options(option, checkpoint=checkpoint, device=device, precision=precision)
    spec = before.model_to_reuse(dict(options)) if model is None else ModelSpec(model, tuple(options))
    source = RunSource(spec, data or before.data, before.data_options | data_options(data_option, depth, focal))
    setup = restore_setup(result, source)
    if sample is not None and corruption is not None and severity is not None:
        target = output or Path(f"{sample.replace('/', '_')}_{corruption}_{severity}.png")
        write_bytes(target, draw_example(result, setup, sample, corruption, severity, named_attacks))
        typer.echo(str(target))
        return
    folder = RunFolder(result.path)
    folder.lock()
    try:
        if write_examples(result, setup):
            write_report(result)
    finally:
        folder.unlock()
    typer.echo(str(result.path / FOLDER))
