"""Options shared by several commands, those of a run among them, and parsers for their values."""

import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer import Option

from ..core.arguments import check_severity
from ..core.errors import UsageError
from ..run.config import DATA, FIELDS, HOW, WHAT, option_of
from . import complete

if TYPE_CHECKING:
    from ..core.types import Sample, SceneDepth
    from ..data.datasets.dataset import Dataset
    from ..models import ModelRef

Command = TypeVar("Command", bound=Callable[..., None])
Given = dict[str, Any]
"""The values of shared options by name."""


def shared(*names: str, **helps: str) -> Callable[[Command], Command]:
    """Add shared options to a command, before its own; it receives their values as keyword arguments `**given`.

    Args:
        *names: names of shared options.
        **helps: names of further shared options, with the help text for this command.
    """

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        own = [
            parameter.replace(kind=parameter.KEYWORD_ONLY)
            for parameter in signature.parameters.values()
            if parameter.kind is not parameter.VAR_KEYWORD
        ]
        parameters = [_SHARED[name] for name in names] + [_with_help(_SHARED[name], helps[name]) for name in helps]
        command.__signature__ = signature.replace(parameters=[*parameters, *own])  # type: ignore[attr-defined]
        return command

    return decorate


def _with_help(parameter: inspect.Parameter, text: str) -> inspect.Parameter:
    kind, option = parameter.annotation.__origin__, parameter.annotation.__metadata__[0]
    changed = type(option)(**vars(option) | {"help": text})
    return parameter.replace(annotation=Annotated[kind, changed])


def _option(name: str, kind: Any, help: str, *flags: str, default: Any = None, **settings: Any) -> inspect.Parameter:
    option = Option(*(flags or (f"--{name.replace('_', '-')}",)), help=help, **settings)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option])


def _of_run() -> Iterator[inspect.Parameter]:
    """Yield the options that are declared in `RunConfig`."""
    for name, field in FIELDS.items():
        if (declared := option_of(field)) is None:
            continue
        kind = {"": field.annotation, "pairs": list[str] | None}.get(declared.parse, str | None)
        yield _option(
            name,
            str if kind is Any else kind,
            declared.help,
            *declared.flags,
            default=field.default if declared.cli_default is None else declared.cli_default,
            rich_help_panel=declared.heading,
            metavar="KEY=VALUE" if declared.parse == "pairs" else None,
            autocompletion=getattr(complete, declared.complete) if declared.complete else None,
        )


def _use_psf_dir(context: typer.Context, folder: Path | None) -> Path | None:
    """Make psf_blur read its PSFs from a folder, here and in workers, which inherit the environment."""
    if folder is not None and not context.resilient_parsing:
        from ..corruptions.blur import PSF_DIR

        if not folder.is_dir():
            raise UsageError(
                "--psf-dir", f"{folder}: no such folder; give the folder that contains the five .pth stacks"
            )
        os.environ[PSF_DIR] = str(folder.absolute())
    return folder


def _import_corruptions(context: typer.Context, targets: list[str] | None) -> list[str] | None:
    """Import user-defined corruptions, so that runs with them can be recomputed."""
    if targets and not context.resilient_parsing:
        from ..corruptions.api import corruption_names

        corruption_names(targets)
    return targets


def _of_commands() -> Iterator[inspect.Parameter]:
    """Yield the other shared options."""
    text, texts, path = str | None, list[str] | None, Path | None
    about = "Name (robustflow list models), module.path:Attribute, exported network (.onnx), or folder of flow files."
    yield _option("model", text, about, "--model", "-m", autocompletion=complete.models)
    yield _option("model_list", texts, about, "--model", "-m", autocompletion=complete.models)
    about = "The model's weights: a file, or a published name (robustflow list models)."
    yield _option("checkpoint", text, about, autocompletion=complete.checkpoints)
    about = "auto, cpu, cuda (every GPU), cuda:0 or cuda:0,cuda:1; for models with this option."
    yield _option("device", text, about)
    yield _option("precision", text, "fp32 or bf16, for models with this option.", rich_help_panel=HOW)
    model = {"metavar": "KEY=VALUE", "rich_help_panel": WHAT}
    yield _option("option", texts, "Model option, e.g. preset=fast. Repeatable.", "--option", "-O", **model)
    about = "Training sets of the model, e.g. C+T (see robustflow list models)."
    yield _option("trained_on", text, about, rich_help_panel=WHAT)
    about = "Folder of depth maps for 3D corruptions, named like the frames (.png, .npy or .pfm)."
    yield _option("depth", path, about, metavar="DIR", rich_help_panel=DATA)
    about = "With --depth, the focal length in pixels; the longer side of the frames by default."
    yield _option("focal", float | None, about, metavar="PX", rich_help_panel=DATA)
    about = "With --depth, the maps' unit: m, cm, mm, or m/N for N per metre; mm for .png and m for others by default."
    yield _option("depth_unit", text, about, metavar="UNIT", rich_help_panel=DATA)
    about = "Folder with the reference code's PSF stacks (.pth) for psf_blur, instead of our lenses."
    yield _option("psf_dir", path, about, callback=_use_psf_dir, rich_help_panel=WHAT)
    about = "Your own corruption that the run used; names stored in a run are never imported."
    yield _option("own_corruption", texts, about, callback=_import_corruptions, metavar="MODULE:ATTRIBUTE")
    yield _option("severity", int, "1 (mild) to 5 (severe).", "--severity", "--severities", "-s", default=3)
    about = "terminal, markdown, latex, csv, html, or MODULE:FUNCTION."
    yield _option("format", str, about, "--format", "-f", default="terminal")
    yield _option("as_json", bool, "Print JSON.", "--json", default=False)


_SHARED = {parameter.name: parameter for parameter in (*_of_run(), *_of_commands())}
COMMON = ("model_list", "benchmark", "data", "corruptions", "severities", "checkpoint", "device", "output")
"""The options of a run that most users need; `run --help` shows the others below "Advanced"."""
RUN: tuple[str, ...] = (*COMMON, "option", "trained_on")
RUN += tuple(parameter.name for parameter in _of_run() if parameter.name not in RUN)
DEPTH = ("depth", "focal", "depth_unit")
RUN += ("psf_dir", *DEPTH, "precision")
"""All options of a run, the common ones first."""
FRAMES = ("seed", "variant", "severity_scale", "psf_dir")
"""Options that change corrupted frames."""
MODEL = ("model", "checkpoint", "device", "precision", "option")
DATASET = ("data", "data_options", *DEPTH)


def refuse_unused(context: typer.Context, unused: Iterable[str], when: str) -> None:
    """Raise a UsageError if the user gave an option that has no effect.

    Args:
        context: context of the command.
        unused: names of the parameters without effect.
        when: the reason, for the message: "with --check".
    """
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name) if parameter.name in unused else None
        if source is not None and source.name == "COMMANDLINE":
            raise UsageError(parameter.opts[0], f"has no effect {when}; leave it out")


def run_arguments(given: Mapping[str, Any]) -> Given:
    """Return the arguments of `evaluate` that the shared options of a run give."""
    parsed: dict[str, Callable[[Any], Any]] = {"names": names, "numbers": numbers, "": lambda value: value}
    arguments = {}
    for name in FIELDS.keys() & given.keys():
        declared = option_of(FIELDS[name])
        if declared is not None and declared.parse != "pairs":
            arguments[name] = parsed[declared.parse](given[name])
    return arguments | {"data_options": data_options(given)}


def data_options(given: Mapping[str, Any]) -> Given:
    """Combine `KEY=VALUE` texts and the user's depth maps into the options of a dataset.

    >>> data_options({"data_options": ["step=2"], "depth": Path("maps"), "focal": 720.0})
    {'step': 2, 'depth': PosixPath('maps'), 'focal': 720.0}
    """
    own = {key: given[key] for key in DEPTH if given.get(key) is not None}
    return dict(keyword_options(given.get("data_options"))) | own


def depth_of(
    sample: "Sample", dataset: "Dataset", corruptions: Iterable[str], given: Mapping[str, Any]
) -> "SceneDepth | None":
    """Return the depth of a sample if a corruption needs it: that of --depth, or of the dataset."""
    from ..data.benchmarks import Benchmark
    from ..data.benchmarks.registry import with_own_depth

    pair = Benchmark("pair", dataset, (sample.key,), tuple(corruptions))
    depths = with_own_depth(pair, *(given[key] for key in DEPTH)).depth_to_read()
    return None if depths is None else depths.depth(sample)


def model_options(given: Mapping[str, Any]) -> tuple[tuple[str, Any], ...]:
    """Combine `KEY=VALUE` texts and dedicated command-line options into the options of a model.

    >>> model_options({"option": ["iterations=24"], "checkpoint": "things", "device": None})
    (('iterations', 24), ('checkpoint', 'things'))
    """
    options = keyword_options(given.get("option"))
    keys = ("checkpoint", "device", "precision", "trained_on")
    named = {key: given[key] for key in keys if given.get(key) is not None}
    for key, _ in options:
        if key in named:
            raise UsageError(key, f"given twice, as -O {key}=... and as --{key.replace('_', '-')}; give it once")
    return options + tuple(named.items())


def model_ref(given: Mapping[str, Any]) -> "ModelRef | None":
    """Return the model that the shared options name, with its options; None without --model."""
    from ..models import ModelRef

    options = model_options(given)
    if given["model"] is None and options:
        raise UsageError(options[0][0], "this is a model option: give the model with --model")
    return None if given["model"] is None else ModelRef.parse(given["model"], options)


def names(text: str | None) -> list[str] | None:
    """Split a comma-separated list.

    >>> names("fog, frost")
    ['fog', 'frost']
    """
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def numbers(text: str | None) -> list[int] | None:
    """Parse a comma-separated list of severities and ranges of severities, each from 1 to 5.

    >>> numbers("1, 3"), numbers("1-3,5")
    ([1, 3], [1, 2, 3, 5])
    """
    levels: list[int] = []
    for part in names(text) or []:
        first, _, last = part.partition("-")
        try:
            ends = int(first), int(last or first)
        except ValueError:
            raise UsageError(text, "not a list of severities: give numbers from 1 to 5, e.g. 1,3 or 1-5") from None
        if ends[0] > ends[1]:
            raise UsageError(part, f"an empty range; write {last}-{first}")
        levels += map(check_severity, range(ends[0], ends[1] + 1))
    return None if text is None else levels


def keyword_options(pairs: list[str] | None) -> tuple[tuple[str, Any], ...]:
    """Parse `KEY=VALUE` texts as options; numbers and true/false are converted, but hashes remain text.

    >>> keyword_options(["preset=fast", "winsize=21"])
    (('preset', 'fast'), ('winsize', 21))
    >>> keyword_options(["sha256=00123456"])
    (('sha256', '00123456'),)
    """
    options = []
    for pair in pairs or []:
        key, sign, text = pair.partition("=")
        if not sign or not key.strip().isidentifier():
            raise UsageError(pair, "not an option: write KEY=VALUE, for example preset=fast")
        key, text = key.strip(), text.strip()
        options.append((key, text if key == "sha256" else _value(text)))
    return tuple(options)


def _value(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
