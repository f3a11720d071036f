"""Every option of a run, declared once: the command line, `evaluate`, the identity of a run and the description of
differences between runs are derived from these fields.

An option that changes frames or errors belongs in `FrameOptions` or `MeasuringOptions`: it reaches the workers and is
part of the identity unless it has its default value. This module imports nothing heavy, because `--help` reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, StrictBool, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo

from ..core.arguments import check_count, check_positive
from ..core.errors import UsageError
from ..core.types import Frozen, Untrusted

WHAT, DATA, HOW, OUTPUT = (f"Advanced: {what}" for what in ("what to measure", "on what", "how", "output"))
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
    cli_default: Any = None
    """Its default on the command line, if it differs from that of `evaluate`."""
    words: tuple[str, ...] = ()
    """A text with a place for the value; of a flag, a text for each of its values."""

    def in_words(self, value: Any) -> str:
        """Describe a value of the option."""
        return self.words[value if len(self.words) > 1 else 0].format(value)


def option(default: Any, help: str, *flags: str, **settings: Any) -> Any:
    """Declare a field that is an option of the command line; settings as for `Option`."""
    declared: Any = {"flags": flags, **settings}
    return Field(default, description=help, json_schema_extra=declared)


def option_of(field: FieldInfo) -> Option | None:
    """Return the declaration of an option; None if it is not an option of the command line."""
    settings: Any = field.json_schema_extra
    return Option(field.description or "", **settings) if settings else None


class FrameOptions(Untrusted):
    """Options that change the corrupted frames."""

    seed: int = option(0, "Random seed; the same seed gives the same bytes on every machine.", words=("seed {}",))
    variant: str = option(
        "default",
        "Variant of the corruptions: default, reference, reference-bgr or paper; attacks: also flowbench or original.",
        words=("{} corruptions",),
    )
    severity_scale: str = option(
        "paper", "paper, or calibrated: the same mean SSIM for every corruption.", words=("{} severities",)
    )

    @field_validator("seed", mode="before")
    @classmethod
    def _whole_number(cls, value: Any) -> int:
        from ..core.rng import check_seed  # imports NumPy

        return check_seed(value)


class MeasuringOptions(Untrusted):
    """Options that change what is measured on a pair."""

    allow_invalid: bool = option(
        False, "Count and exclude NaN or infinite predicted pixels instead of failing.", "--allow-invalid", heading=HOW
    )
    confidence: str | None = option(
        None, "Measure how well confidence predicts errors; its source: forward-backward (consistency) or model."
    )
    draws: int = Field(default=1, ge=1)


def _counted(value: Any, info: ValidationInfo) -> Any:
    if value is None:
        return None
    check_count(f"--{str(info.field_name).replace('_', '-')}", value)
    return int(value)


def _positive(value: Any) -> Any:
    if value is not None:
        check_positive("--timeout", value)
    return value


_Count = Annotated[int | None, BeforeValidator(_counted)]


class Selection(Frozen):
    """Which conditions are measured on which pairs; their names are checked where the benchmark is opened."""

    benchmark: Any = option(
        "demo",
        "demo, kitti-fc, gopro-fc, any dataset (folder, sintel, ...), or your own module.path:Attribute.",
        *("--benchmark", "-b"),
        heading=None,
        complete="benchmarks",
    )
    data: Path | None = option(None, "Folder of the dataset (or a video, for 'folder').", "--data", "-d", heading=None)
    corruptions: Any = option(
        None,
        "Comma-separated names, families (weather), stacks (fog+snow), or your own module:Attribute; all by default.",
        *("--corruptions", "--corruption", "-c"),
        heading=None,
        parse="names",
        complete="corruptions",
    )
    severities: Any = option(
        None,
        "Severities, 1 (mild) to 5 (severe), e.g. 3 or 1,3 or 1-5.",
        *("--severities", "--severity", "-s"),
        heading=None,
        parse="numbers",
    )
    attacks: Any = option(
        None,
        "Comma-separated attacks on the model (robustflow list attacks), with options after colons (pgd:steps=40); "
        "corruptions are run only if --corruptions is given.",
        *("--attacks", "--attack"),
        parse="names",
    )
    limit: _Count = option(None, "Use only N pairs, evenly spaced in the dataset.", heading=DATA)
    subset: str | None = option(
        None,
        "quick: a small set of conditions that ranks models like the full set (kitti-fc); its means are estimates.",
    )
    split: Path | None = option(
        None, "File with the names of the pairs to use, one per line; or drive-disjoint (KITTI 2015).", heading=DATA
    )
    data_options: dict[str, Any] | None = option(
        None, "Dataset option, e.g. step=2. Repeatable.", "--data-option", "-D", heading=DATA, parse="pairs"
    )
    still: StrictBool = option(
        False, "Pair every frame with itself; the true flow is zero, so errors are phantom motion.", "--still"
    )


class Compute(Frozen):
    """How a run is computed, which does not change its numbers."""

    workers: _Count = option(
        None,
        "Number of processes; for a model on GPUs, of those that load data. Default: depends on model and machine.",
        *("--workers", "-w"),
        heading=HOW,
    )
    batch_size: Annotated[int, BeforeValidator(_counted)] = option(
        1, "Number of pairs to predict or attack per call, for models that support batches.", heading=HOW
    )
    engine: str | None = option(
        None, "serial, processes or ray; by default it depends on --device and --workers.", heading=HOW
    )
    address: str | None = option(
        None, "Address of the Ray cluster: auto, host:port or ray://host:port; this machine by default.", heading=HOW
    )
    timeout: Annotated[float | None, BeforeValidator(_positive)] = option(
        None, "Time limit for a single prediction, batch or attack, in seconds.", heading=HOW
    )


class Output(Frozen):
    """Where a run is stored, and how it is shown."""

    output: Path | None = option(
        None,
        "Folder of the run, or parent folder for several runs; in runs/ by default.",
        *("--output", "-o"),
        heading=None,
    )
    name: str | None = option(None, "Display name of the model in tables and figures.", heading=OUTPUT)
    examples: StrictBool = option(
        False,
        "Draw pictures of the worst and the median sample at the end.",
        "--examples/--no-examples",
        heading=OUTPUT,
        cli_default=True,
    )


class RunConfig(Frozen):
    """The options of one run, by concern."""

    selection: Selection = Selection()
    frames: FrameOptions = FrameOptions()
    measuring: MeasuringOptions = MeasuringOptions()
    compute: Compute = Compute()
    output: Output = Output()

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> RunConfig:
        """Return the options among some arguments, by name; an invalid value raises a UsageError."""
        made: dict[str, Any] = {}
        for name, part in _PARTS.items():
            given = {field: arguments[field] for field in part.model_fields if field in arguments}
            try:
                made[name] = part(**given)
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                if isinstance(cause := first.get("ctx", {}).get("error"), UsageError):
                    raise cause from None
                raise UsageError(str(first["loc"][0]), f"{first['msg']}, not {first['input']!r:.60}") from None
        return cls(**made)


DEFAULTS = RunConfig()

_PARTS = {name: type(part) for name, part in DEFAULTS}
FIELDS: dict[str, FieldInfo] = {name: field for part in _PARTS.values() for name, field in part.model_fields.items()}
"""Every option of a run by name: the keyword arguments of `evaluate`."""
