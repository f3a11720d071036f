"""`robustflow optics`: the lenses of psf_blur."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from ..core.errors import DataError, UsageError
from ..core.files import make_folder, write_bytes
from ..core.output import echo
from .options import numbers, refuse_unused, shared

app = typer.Typer(no_args_is_help=True)

_Severities = Annotated[str, Option("--severity", "--severities", "-s", help="Comma-separated, 1 to 5.")]
_Lens = Annotated[Path | None, Option(help="Prescription to use instead of the shipped ones.")]


@app.command()
@shared(output="File to write the prescription to.")
def design(
    severity: Annotated[int, Option("--severity", "--severities", "-s", help="1 to 5.")],
    seed: Annotated[int, Option(help="Integer random seed; that of the shipped lens is 0.")] = 0,
    ship: Annotated[bool, Option("--ship", help="Replace the package's lens and its PSFs.")] = False,
    **given: Any,
) -> None:
    """Search for the lens of a severity (takes minutes); deterministic for a given severity and seed.

    \b
    Example:
      robustflow optics design --severity 4 --seed 7 --output lens.json
    """
    from ..corruptions.optics.design import design as search_lens
    from ..corruptions.optics.design import lens_digest, ship_lens, structure_line
    from ..corruptions.optics.lens import write_lens
    from ..corruptions.optics.psf_field import manifest
    from ..corruptions.optics.render import render_psfs

    lens = search_lens(severity, seed, report=typer.echo)
    echo(f"found: {structure_line(lens)}")
    if ship:
        ship_lens(severity, lens, render_psfs(lens))
        echo("saved in the package")
    elif seed == 0:
        same = lens_digest(lens) == manifest()[f"lens_s{severity}"]
        echo(f"{'identical to' if same else 'differs from'} the shipped lens")
    if given["output"] is not None:
        write_lens(lens, given["output"])
        echo(str(given["output"]))


@app.command()
@shared(output="Folder for the figures; 'optics' by default.")
def show(context: typer.Context, severity: _Severities = "1,2,3,4,5", lens: _Lens = None, **given: Any) -> None:
    """Draw each lens with its rays, spots, modulation and PSFs; then all PSFs on one sheet, and their profiles next to
    those of the reference.

    \b
    Example:
      robustflow optics show --severity 4 --output figures
    """
    from ..corruptions.optics.design import shipped_lens
    from ..corruptions.optics.draw import contact_sheet, lens_figure, profile_figure, save_figure
    from ..corruptions.optics.lens import read_lens
    from ..corruptions.optics.psf_field import shipped_field
    from ..corruptions.optics.render import render_psfs

    if lens is not None:
        refuse_unused(context, {"severity"}, "with --lens")
        own = read_lens(lens)
        shown = [(lens.stem, own, render_psfs(own))]
    else:
        shown = [(f"lens_s{k}", shipped_lens(k), shipped_field(k)) for k in numbers(severity) or []]
    output = given["output"] or Path("optics")
    make_folder(output)
    figures = {name: lens_figure(prescription, field) for name, prescription, field in shown}
    figures["psf_sheet"] = contact_sheet([(name, field) for name, _, field in shown])
    if lens is None:
        figures["psf_profile"] = profile_figure([(int(name[-1]), field) for name, _, field in shown])
    for name, figure in figures.items():
        for suffix in (".png", ".pdf"):
            save_figure(figure, output / f"{name}{suffix}")
            echo(str(output / f"{name}{suffix}"))


@app.command()
@shared(output="With --lens: .npy file to write.")
def render(context: typer.Context, severity: _Severities = "1,2,3,4,5", lens: _Lens = None, **given: Any) -> None:
    """Render the PSFs of the shipped lenses and check that they equal the shipped PSFs bit for bit.

    With --lens, render your own prescription to a .npy file of shape (64, 3, 61, 61), float32.

    \b
    Example:
      robustflow optics render --lens lens.json --output psf.npy
    """
    import io

    import numpy as np

    from ..corruptions.optics.design import shipped_lens
    from ..corruptions.optics.lens import read_lens
    from ..corruptions.optics.psf_field import half_digest, halved, manifest
    from ..corruptions.optics.render import render_psfs

    output = given["output"]
    if (lens is None) != (output is None):
        raise UsageError("--output", "give it together with --lens: the prescription, and the file for its PSFs")
    if lens is not None:
        refuse_unused(context, {"severity"}, "with --lens")
        buffer = io.BytesIO()
        np.save(buffer, render_psfs(read_lens(lens)).stack, allow_pickle=False)
        write_bytes(output, buffer.getvalue())
        echo(str(output))
        return
    wrong = []
    for level in numbers(severity) or []:
        same = half_digest(halved(render_psfs(shipped_lens(level)))) == manifest()[f"psf_s{level}"]
        echo(f"severity {level}: {'as shipped' if same else 'DIFFERS from the shipped PSFs'}")
        if not same:
            wrong.append(str(level))
    if wrong:
        raise DataError(f"severity {', '.join(wrong)}", "the PSFs do not match their prescriptions; reinstall")
