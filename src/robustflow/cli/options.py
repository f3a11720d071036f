"""Options shared by several commands, and parsers for their values."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.arguments import check_severity
from ..core.errors import UsageError
from . import complete

WHAT, DATA, HOW, OUTPUT = "What to measure", "On what", "How", "Output"
"""Headings of options in `--help`; the most common options have no heading and come first."""

_MODEL = typer.Option(
    "--model",
    "-m",
    autocompletion=complete.models,
    help="Name (robustflow list models), module.path:Attribute, an exported network (.onnx), or a folder of "
    "flow files.",
)
ModelName = Annotated[str, _MODEL]
ModelNames = Annotated[list[str] | None, _MODEL]
"""Repeatable; models run one after another."""
ModelOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--option", "-O", metavar="KEY=VALUE", help="Model option, e.g. preset=fast. Repeatable.", rich_help_panel=WHAT
    ),
]
Checkpoint = Annotated[
    str | None,
    typer.Option(
        autocompletion=complete.checkpoints,
        help="The model's weights: a file, or a published name (robustflow list models).",
    ),
]
Device = Annotated[
    str | None, typer.Option(help="auto, cpu, cuda (every GPU), cuda:0 or cuda:0,cuda:1; for models with this option.")
]
Precision = Annotated[
    str | None,
    typer.Option(help="fp32 or bf16, for models with this option.", rich_help_panel=HOW),
]
Data = Annotated[Path | None, typer.Option("--data", "-d", help="Folder of the dataset (or a video, for 'folder').")]
DataOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--data-option",
        "-D",
        metavar="KEY=VALUE",
        help="Dataset option, e.g. step=2. Repeatable.",
        rich_help_panel=DATA,
    ),
]
Split = Annotated[
    Path | None,
    typer.Option(
        help="File with the names of the pairs to use, one per line; or drive-disjoint (KITTI 2015).",
        rich_help_panel=DATA,
    ),
]
Depth = Annotated[
    Path | None,
    typer.Option(
        "--depth",
        metavar="DIR",
        help="Folder of depth maps for 3D corruptions: named like the frames, .png (16 bits, mm), .npy or .pfm "
        "(metres).",
        rich_help_panel=DATA,
    ),
]
Focal = Annotated[
    float | None,
    typer.Option(
        "--focal",
        metavar="PX",
        help="With --depth, the focal length in pixels; the longer side of the frames by default.",
        rich_help_panel=DATA,
    ),
]
OwnCorruptions = Annotated[
    list[str] | None,
    typer.Option(
        "--own-corruption",
        metavar="MODULE:ATTRIBUTE",
        help="Your own corruption that the run used. It must be given: names stored in a run are never imported.",
    ),
]
Corruptions = Annotated[
    str | None,
    typer.Option(
        "--corruptions",
        "--corruption",
        "-c",
        autocompletion=complete.corruptions,
        help="Comma-separated names, families (weather), stacks (fog+snow), or your own module.path:Attribute; all by "
        "default.",
        rich_help_panel=WHAT,
    ),
]
Attacks = Annotated[
    str | None,
    typer.Option(
        "--attacks",
        "--attack",
        help="Comma-separated adversarial attacks on the model (robustflow list attacks), with options after colons "
        "(pgd:steps=40:loss=cosine, transfer:tiny, worst_of:apgd+square). Random noise of the same norms is added as "
        "a baseline; corruptions are run only if --corruptions is given.",
        rich_help_panel=WHAT,
    ),
]
Benchmark = Annotated[
    str,
    typer.Option(
        "--benchmark",
        "-b",
        autocompletion=complete.benchmarks,
        help="demo, kitti-fc, gopro-fc, any dataset (folder, sintel, ...), or your own module.path:Attribute.",
    ),
]
Severities = Annotated[
    str | None,
    typer.Option(
        "--severities",
        "--severity",
        "-s",
        help="Severities, 1 (mild) to 5 (severe), e.g. 3 or 1,3 or 1-5.",
        rich_help_panel=WHAT,
    ),
]
Limit = Annotated[
    int | None,
    typer.Option(help="Use only N pairs, evenly spaced in the dataset.", rich_help_panel=DATA),
]
Seed = Annotated[
    int,
    typer.Option(help="Random seed; the same seed produces the same bytes on every machine.", rich_help_panel=WHAT),
]
Variant = Annotated[
    str,
    typer.Option(
        help="Variant of the corruptions: default, reference, reference-bgr or paper; for attacks also flowbench or "
        "original.",
        rich_help_panel=WHAT,
    ),
]
CommonDraws = Annotated[
    bool,
    typer.Option(
        "--common-draws",
        help="Use one random draw for all five severities of a pair instead of one per severity.",
        rich_help_panel=WHAT,
    ),
]
PsfDir = Annotated[
    Path | None,
    typer.Option(
        "--psf-dir",
        help="Folder with the reference code's PSF stacks (.pth) for psf_blur, used instead of the project's lenses.",
        rich_help_panel=WHAT,
    ),
]
SeverityScale = Annotated[
    str,
    typer.Option(
        "--severity-scale",
        help="paper, or calibrated: the same mean SSIM for every corruption (see robustflow optics calibrate).",
        rich_help_panel=WHAT,
    ),
]


Format = Annotated[
    str, typer.Option("--format", "-f", help="terminal, markdown, latex, csv, html, or MODULE:FUNCTION.")
]


def refuse_unused(context: typer.Context, unused: Iterable[str], when: str) -> None:
    """Raise if the user gave an option that has no effect.

    Args:
        context: context of the command.
        unused: names of the parameters without effect.
        when: the reason, for the message: "with --check".

    Raises:
        UsageError: one of the options was given.
    """
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name) if parameter.name in unused else None
        if source is not None and source.name == "COMMANDLINE":
            raise UsageError(f"{parameter.opts[0]} has no effect {when}; leave it out")


def use_own_corruptions(targets: list[str] | None) -> None:
    """Import user-defined corruptions, so that runs with them can be recomputed.

    Raises:
        UsageError: an attribute cannot be imported, or is not a corruption.
    """
    from ..corruptions.api import corruption_name

    for target in targets or []:
        corruption_name(target)


def use_psf_dir(folder: Path | None) -> None:
    """Make psf_blur read its PSFs from `folder` in this process and in workers, which inherit the environment.

    Raises:
        UsageError: the folder does not exist.
    """
    from ..corruptions.blur.psf_blur import PSF_DIR

    if folder is not None:
        if not folder.is_dir():
            raise UsageError(f"--psf-dir {folder}: no such folder; give the folder that contains the five .pth stacks")
        os.environ[PSF_DIR] = str(folder.absolute())


def data_options(pairs: list[str] | None, depth: Path | None = None, focal: float | None = None) -> dict[str, Any]:
    """Combine `KEY=VALUE` texts and the user's depth maps into the options of a dataset.

    Raises:
        UsageError: as for `keyword_options`.

    >>> data_options(["step=2"], Path("maps"), 720.0)
    {'step': 2, 'depth': PosixPath('maps'), 'focal': 720.0}
    """
    own = {"depth": depth, "focal": focal}
    return dict(keyword_options(pairs)) | {key: value for key, value in own.items() if value is not None}


def names(text: str | None) -> list[str] | None:
    """Split a comma-separated list.

    >>> names("fog, frost")
    ['fog', 'frost']
    """
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def numbers(text: str | None) -> list[int] | None:
    """Parse a comma-separated list of severities and ranges of severities.

    Raises:
        UsageError: an item is not an integer from 1 to 5 or a range of these.

    >>> numbers("1, 3"), numbers("1-3,5")
    ([1, 3], [1, 2, 3, 5])
    """
    levels: list[int] = []
    for part in names(text) or []:
        first, _, last = part.partition("-")
        try:
            ends = int(first), int(last or first)
        except ValueError:
            raise UsageError(
                f"'{text}' is not a list of severities: give numbers from 1 to 5, e.g. 1,3 or 1-5"
            ) from None
        if ends[0] > ends[1]:
            raise UsageError(f"severities {part}: the range is empty; write {last}-{first}")
        levels += map(check_severity, range(ends[0], ends[1] + 1))
    return None if text is None else levels


def keyword_options(pairs: list[str] | None) -> tuple[tuple[str, Any], ...]:
    """Parse `KEY=VALUE` texts as options; numbers and true/false are converted, but hashes remain text.

    Raises:
        UsageError: a text has no key or no equals sign.

    >>> keyword_options(["preset=fast", "winsize=21"])
    (('preset', 'fast'), ('winsize', 21))
    >>> keyword_options(["sha256=00123456"])
    (('sha256', '00123456'),)
    """
    options = []
    for pair in pairs or []:
        key, sign, text = pair.partition("=")
        if not sign or not key.strip().isidentifier():
            raise UsageError(f"'{pair}' is not an option: write KEY=VALUE, for example preset=fast")
        key, text = key.strip(), text.strip()
        options.append((key, text if key == "sha256" else _value(text)))
    return tuple(options)


def model_options(pairs: list[str] | None, **named: str | None) -> tuple[tuple[str, Any], ...]:
    """Combine `KEY=VALUE` texts and dedicated command-line options into the options of a model.

    Raises:
        UsageError: as for `keyword_options`, or an option is given both ways.

    >>> model_options(["iterations=24"], checkpoint="things", device=None)
    (('iterations', 24), ('checkpoint', 'things'))
    """
    options = keyword_options(pairs)
    given = {key: value for key, value in named.items() if value is not None}
    for key, _ in options:
        if key in given:
            raise UsageError(f"{key} is given twice, as -O {key}=... and as --{key.replace('_', '-')}; give it once")
    return options + tuple(given.items())


def _value(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
