"""Every option of a run, declared once: the command line, `evaluate`, the identity of a run and the description of
differences between runs are derived from these fields.

An option that changes frames or errors belongs in `FrameOptions` or `MeasuringOptions`: it reaches the workers and is
part of the identity unless it has its default value. This module imports nothing heavy, because `--help` reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, SkipValidation, ValidationError
from pydantic.fields import FieldInfo

from ..core.errors import UsageError
from ..core.types import Frozen, Untrusted

COMMON, WHAT, DATA, HOW, OUTPUT = None, "What to measure", "On what", "How", "Output"
"""Headings of options in `run --help`; the most common options have no heading and come first."""


@dataclass(frozen=True)
class Option:
    """How an option is written on the command line, and how its value is described where runs differ."""

    help: str
    flags: tuple[str, ...] = ()
    heading: str | None = WHAT
    parse: Literal["", "names", "numbers", "pairs"] = ""
    """How its text is read; "" for a value of the field's type."""
    complete: str = ""
    """The function of `cli.complete` that completes its values."""
    default: Any = None
    """Its default on the command line, if it differs from that of `evaluate`."""
    words: Callable[[Any], str] | None = None


def _seed(value: Any) -> int:
    from ..core.rng import check_seed  # imports NumPy

    return check_seed(value)


def _draws(value: Any) -> int:
    from ..models.conventions import check_count

    check_count("draws", value)
    return int(value)


class FrameOptions(Untrusted):
    """Options that change the corrupted frames."""

    seed: Annotated[
        int,
        BeforeValidator(_seed),
        Option("Random seed; the same seed gives the same bytes on every machine.", words=lambda seed: f"seed {seed}"),
    ] = 0
    variant: Annotated[
        str,
        Field(min_length=1),
        Option(
            "Variant of the corruptions: default, reference, reference-bgr or paper; for attacks also flowbench or "
            "original.",
            words=lambda variant: f"{variant} corruptions",
        ),
    ] = "default"
    severity_scale: Annotated[
        str,
        Field(min_length=1),
        Option(
            "paper, or calibrated: the same mean SSIM for every corruption.", words=lambda scale: f"{scale} severities"
        ),
    ] = "paper"
    common_draws: Annotated[
        bool,
        Option(
            "Use one random draw for all five severities of a pair.",
            words=lambda common: "one draw for all severities" if common else "one draw for each severity",
        ),
    ] = False


class MeasuringOptions(Untrusted):
    """Options that change what is measured on a pair."""

    allow_invalid: Annotated[
        bool, Option("Count and exclude NaN or infinite predicted pixels instead of failing.", heading=HOW)
    ] = False
    confidence: Annotated[
        Annotated[str, Field(min_length=1)] | None,
        Option("Measure how well confidence predicts errors; its source: forward-backward (consistency) or model."),
    ] = None
    draws: Annotated[int, BeforeValidator(_draws)] = 1


class Selection(Frozen):
    """Which conditions are measured on which pairs; checked where the benchmark is opened."""

    benchmark: Annotated[
        SkipValidation[Any],
        Option(
            "demo, kitti-fc, gopro-fc, any dataset (folder, sintel, ...), or your own module.path:Attribute.",
            ("--benchmark", "-b"),
            COMMON,
            complete="benchmarks",
        ),
    ] = "demo"
    data: Annotated[
        SkipValidation[Path | None],
        Option("Folder of the dataset (or a video, for 'folder').", ("--data", "-d"), COMMON),
    ] = None
    corruptions: Annotated[
        SkipValidation[Any],
        Option(
            "Comma-separated names, families (weather), stacks (fog+snow), or your own module.path:Attribute; all by "
            "default.",
            ("--corruptions", "--corruption", "-c"),
            parse="names",
            complete="corruptions",
        ),
    ] = None
    severities: Annotated[
        SkipValidation[Any],
        Option(
            "Severities, 1 (mild) to 5 (severe), e.g. 3 or 1,3 or 1-5.",
            ("--severities", "--severity", "-s"),
            parse="numbers",
        ),
    ] = None
    attacks: Annotated[
        SkipValidation[Any],
        Option(
            "Comma-separated attacks on the model (robustflow list attacks), with options after colons "
            "(pgd:steps=40); corruptions are run only if --corruptions is given.",
            ("--attacks", "--attack"),
            parse="names",
        ),
    ] = None
    limit: Annotated[
        SkipValidation[int | None], Option("Use only N pairs, evenly spaced in the dataset.", heading=DATA)
    ] = None
    subset: Annotated[
        SkipValidation[str | None],
        Option(
            "quick: a small set of conditions that ranks models like the full set (kitti-fc); its means are estimates."
        ),
    ] = None
    split: Annotated[
        SkipValidation[Path | None],
        Option("File with the names of the pairs to use, one per line; or drive-disjoint (KITTI 2015).", heading=DATA),
    ] = None
    data_options: Annotated[
        SkipValidation[Any],
        Option("Dataset option, e.g. step=2. Repeatable.", ("--data-option", "-D"), DATA, parse="pairs"),
    ] = None
    still: Annotated[
        SkipValidation[bool],
        Option("Pair every frame with itself; the true flow is zero, so errors are phantom motion."),
    ] = False


class Compute(Frozen):
    """How a run is computed, which does not change its numbers; checked where the engine is chosen."""

    workers: Annotated[
        SkipValidation[int | None],
        Option(
            "Number of processes; for a model on GPUs, of those that load data. By default it depends on the model and "
            "the machine.",
            ("--workers", "-w"),
            HOW,
        ),
    ] = None
    batch_size: Annotated[
        SkipValidation[int],
        Option("Number of pairs to predict or attack per call, for models that support batches.", heading=HOW),
    ] = 1
    engine: Annotated[
        SkipValidation[str | None],
        Option("serial, processes or ray; by default it depends on --device and --workers.", heading=HOW),
    ] = None
    address: Annotated[
        SkipValidation[str | None],
        Option("Address of the Ray cluster: auto, host:port or ray://host:port; this machine by default.", heading=HOW),
    ] = None
    timeout: Annotated[
        SkipValidation[float | None],
        Option("Time limit for a single prediction, batch or attack, in seconds.", heading=HOW),
    ] = None


class Output(Frozen):
    """Where a run is stored, and how it is shown."""

    output: Annotated[
        SkipValidation[Path | None],
        Option(
            "Folder of the run, or parent folder for several runs; in runs/ by default.", ("--output", "-o"), COMMON
        ),
    ] = None
    name: Annotated[
        SkipValidation[str | None], Option("Display name of the model in tables and figures.", heading=OUTPUT)
    ] = None
    examples: Annotated[
        SkipValidation[bool],
        Option(
            "Draw pictures of the worst and the median sample at the end.",
            ("--examples/--no-examples",),
            OUTPUT,
            default=True,
        ),
    ] = False


class RunConfig(Frozen):
    """The options of one run, by concern."""

    selection: Selection = Selection()
    frames: FrameOptions = FrameOptions()
    measuring: MeasuringOptions = MeasuringOptions()
    compute: Compute = Compute()
    output: Output = Output()

    parts: ClassVar[Mapping[str, type[Frozen]]] = {
        "selection": Selection,
        "frames": FrameOptions,
        "measuring": MeasuringOptions,
        "compute": Compute,
        "output": Output,
    }

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> RunConfig:
        """Return the options among some arguments, by name; an invalid value raises a UsageError."""
        made: dict[str, Any] = {}
        for name, part in cls.parts.items():
            given = {field: arguments[field] for field in part.model_fields if field in arguments}
            try:
                made[name] = part(**given)
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                raise UsageError(str(first["loc"][0]), f"{first['msg']}, not {first['input']!r:.60}") from None
        return cls(**made)


DEFAULTS = RunConfig()

FIELDS: dict[str, FieldInfo] = {
    name: field for part in RunConfig.parts.values() for name, field in part.model_fields.items()
}
"""Every option of a run by name: the keyword arguments of `evaluate`."""


def option_of(field: FieldInfo) -> Option | None:
    """Return the declaration of an option; None if it is not an option of the command line."""
    return next((each for each in field.metadata if isinstance(each, Option)), None)
