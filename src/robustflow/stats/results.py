"""Names and labels of metrics, conditions, corruptions and settings in results, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping

from ..core.text import plain
from ..corruptions.registry import FAMILIES, MEMBERS, ON_DISK, ON_DISK_PREFIX, family_of
from ..data.benchmarks import benchmark_facts
from ..metrics.cube import AVERAGE
from ..metrics.error_maps import crer
from ..metrics.measures import LABELS, UNITS, exact_mean
from ..metrics.rows import CLEAN

__all__ = ["AVERAGE", "CLEAN", "LABELS", "RESULT_METRICS", "UNITS"]

RESULT_METRICS = ("epe", "cre", "rcre", "crer")
"""Metrics of results, in pixels except the last, which has no unit."""
METRIC_LABELS = {metric: LABELS[metric] for metric in (*RESULT_METRICS, "photometric")}
OVERALL = (("epe", CLEAN), ("epe", AVERAGE), ("cre", AVERAGE), ("crer", AVERAGE), ("rcre", AVERAGE))
"""The overall means of a model, as (metric, condition)."""

SETTING_LABELS = {
    "knowledge": "Knowledge-driven (knowledge)",
    "OOD": "Out-of-domain (OOD)",
    "ID": "In-domain (ID)",
    "LEAKED": "Trained on the evaluated pairs (LEAKED)",
    "UNKNOWN": "Training not documented (UNKNOWN)",
    "untrained": "Random weights (untrained)",
}
SETTING_EXPLANATIONS = {
    "knowledge": "is not a learned method",
    "OOD": "was not trained on data from the benchmark's domain",
    "ID": "was trained on the domain, but not on the evaluated frames",
    "LEAKED": "was trained on the evaluated frames",
    "UNKNOWN": "its training data are not documented; declare them with --trained-on",
    "untrained": "has random weights and is never ranked",
}
NEVER_RANKED = {"untrained": "its weights are random"}
"""Settings whose models are never ranked, with the reason."""
FAMILY_LABELS = {name: name.capitalize() for name in FAMILIES}

_SHORT = {
    "jpeg_compression": "JPEG",
    "high_light": "HL",
    "low_light": "LL",
    "over_exposure": "OE",
    "under_exposure": "UE",
    "gaussian_noise": "Gaussian",
    "shot_noise": "Shot",
    "impulse_noise": "Impulse",
    "gaussian_blur": "Gaussian",
    "defocus_blur": "Defocus",
    "glass_blur": "Glass",
    "camera_motion_blur": "Camera",
    "object_motion_blur": "Object",
    "psf_blur": "PSF",
    "h264_crf": "CRF",
    "h264_abr": "ABR",
    "bit_error": "Bit error",
}


def family_means(values: Mapping[str, float]) -> dict[str, float]:
    """Average each family over its measured corruptions.

    >>> family_means({"snow": 2.0, "fog": 1.0})
    {'weather': 1.5}
    """
    known = {family: [values[name] for name in members if name in values] for family, members in MEMBERS.items()}
    return {family: exact_mean(parts) for family, parts in known.items() if parts}


def family_crer(cre: Mapping[str, float], clean: float | None) -> dict[str, float]:
    """Return the CREr of each family: the mean CRE of its measured corruptions, divided by the clean EPE (`crer`)."""
    ratios = {family: crer(mean, clean) for family, mean in family_means(cre).items()}
    return {family: ratio for family, ratio in ratios.items() if ratio is not None}


def metric_label(metric: str) -> str:
    """Return the name of a measure with its unit.

    >>> metric_label("cre"), metric_label("crer")
    ('CRE (px)', 'CREr')
    """
    return f"{LABELS[metric]} ({UNITS[metric]})" if UNITS[metric] else LABELS[metric]


def mean_label(metric: str, condition: str) -> str:
    """Return the label of an overall mean.

    >>> mean_label("epe", "clean"), mean_label("epe", "average")
    ('clean EPE', 'EPE')
    """
    return f"{'clean ' if condition == CLEAN else ''}{LABELS[metric]}"


def benchmark_label(benchmark: str) -> str:
    """Return the title of a benchmark for a heading, or its name if the benchmark is unknown.

    >>> benchmark_label("kitti-fc"), benchmark_label("sintel"), benchmark_label("folder")
    ('KITTI-FC', 'MPI-Sintel', 'Your own frames')
    """
    return plain(benchmark_facts(benchmark).title, 40)


def benchmark_words(benchmark: str) -> str:
    """Return the name of a benchmark for use within a sentence.

    >>> benchmark_words("folder"), benchmark_words("demo")
    ('your own frames', 'the demo')
    """
    label = benchmark_label(benchmark)
    return "the demo" if label == "demo" else label.replace("Your own", "your own", 1)


def on_benchmark(model: str, benchmark: str) -> str:
    """Describe a model and its benchmark; the benchmark is not repeated if the name already contains it.

    >>> on_benchmark("DIS", "gopro-fc"), on_benchmark("DIS (GoPro-FC)", "gopro-fc")
    ('DIS on GoPro-FC', 'DIS on GoPro-FC')
    """
    return f"{model.removesuffix(f' ({benchmark_label(benchmark)})')} on {benchmark_words(benchmark)}"


def short_label(corruption: str) -> str:
    """Return the name of a corruption as in the paper's tables, for use below its family name. The source is added
    for a corruption that exists only as files.

    >>> short_label("gaussian_noise"), short_label("fog"), short_label("robustspring_fog")
    ('Gaussian', 'Fog', 'RS fog')
    """
    if corruption in ON_DISK:
        return f"RS {inside(short_label(corruption.removeprefix(ON_DISK_PREFIX)))}"
    return _SHORT.get(corruption, corruption.replace("_", " ").capitalize())


def long_label(corruption: str) -> str:
    """Return the name of a corruption in running text.

    >>> long_label("psf_blur"), long_label("h264_crf"), long_label("robustspring_zoom_blur")
    ('PSF blur', 'H.264 CRF', 'RobustSpring zoom blur')
    """
    if corruption in ON_DISK:
        return f"RobustSpring {inside(long_label(corruption.removeprefix(ON_DISK_PREFIX)))}"
    words = corruption.replace("_", " ").capitalize()
    return (
        words.replace("Jpeg", "JPEG")
        .replace("Psf", "PSF")
        .replace("H264 crf", "H.264 CRF")
        .replace("H264 abr", "H.264 ABR")
    )


def family_label(corruption: str) -> str | None:
    """Return the heading above a corruption's column; None for a corruption without a family.

    >>> family_label("robustspring_rain"), family_label("elastic_transform")
    ('Weather', None)
    """
    family = family_of(corruption)
    return None if family is None else FAMILY_LABELS[family]


def inside(label: str) -> str:
    """Lowercase the first letter of a label for use within a sentence, unless the label starts with an abbreviation."""
    return label[:1].lower() + label[1:] if label.partition(" ")[0][1:].islower() else label
