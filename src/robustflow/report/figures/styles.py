"""Colours and markers in all figures: of a published model's kind, or of one of the other models."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from matplotlib.lines import Line2D

from ...analysis.model_result import ModelResult
from ...analysis.published.tables import method_of, of_paper
from ...text import name_text

# Okabe and Ito's palette, and four colours in between
ORANGE, SKY, GREEN, OLIVE, BLUE, RED, PINK, BLACK = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#9A8F00",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
    "#000000",
)
VIOLET, BROWN, NAVY = "#6A3D9A", "#8C5A2B", "#24407A"
GREY, GRID = "#999999", "#dddddd"


@dataclass(frozen=True)
class Style:
    """The colour and the marker of a model."""

    colour: str
    marker: str = "o"


KIND_STYLES = {
    "CNN-based": Style(PINK),
    "Transformer-based": Style(GREEN),
    "Unsupervised": Style(BLUE),
    "Knowledge-driven": Style(GREY),
}
"""Near the paper's: purple for CNNs, green for Transformers, blue for unsupervised models."""

MODEL_STYLES = (
    Style(ORANGE, "o"),
    Style(VIOLET, "s"),
    Style(RED, "^"),
    Style(BLACK, "D"),
    Style(SKY, "v"),
    Style(BROWN, "P"),
    Style(OLIVE, "X"),
    Style(NAVY, "p"),
)
"""Styles of models that are not published ones; none has the colour of a kind, so that both can be on one page."""

OTHER = Style("#666666")
"""Style of models beyond `MODEL_STYLES` in a figure that prints names next to its points."""


@dataclass(frozen=True)
class Looks:
    """What a figure is given besides the results of its models.

    Attributes:
        styles: by line; published models are coloured by kind, and others in their order, where it is empty.
        legend: whether the figure draws its legend, or a page writes it (`MarkedFigure.key`).
    """

    styles: Mapping[ModelResult, Style] = field(default_factory=dict)
    legend: bool = True

    def of(self, results: Sequence[ModelResult]) -> dict[ModelResult, Style]:
        """The style of every line of some results."""
        if of_paper(results):
            return {line: KIND_STYLES.get(kind_of(line.name), OTHER) for line in results}
        by_place = model_styles(line.name for line in results)
        return {line: self.styles.get(line, by_place[line.name]) for line in results}


def kind_of(model: str) -> str:
    """The kind of a published model: a key of `KIND_STYLES`, "" for other models.

    >>> kind_of("SAMFlow-H"), kind_of("CRAFT"), kind_of("ARFlow"), kind_of("DIS")
    ('Transformer-based', 'Transformer-based', 'Unsupervised', 'Knowledge-driven')
    """
    method = method_of(model)
    if method is None:
        return ""
    if method.type != "supervised":
        return {"unsupervised": "Unsupervised", "knowledge": "Knowledge-driven"}[method.type]
    return "Transformer-based" if "Transformer" in method.encoder else "CNN-based"


def model_styles(models: Iterable[str]) -> dict[str, Style]:
    """The style of each model by its place; `OTHER` for those for which none is left.

    >>> list(model_styles(["DIS", "Mine"]).values())
    [Style(colour='#E69F00', marker='o'), Style(colour='#6A3D9A', marker='s')]
    """
    return {
        model: MODEL_STYLES[index] if index < len(MODEL_STYLES) else OTHER
        for index, model in enumerate(dict.fromkeys(models))
    }


def distinct_styles(styles: Mapping[str, Style | None]) -> dict[str, Style]:
    """The styles of a few models, if known; by their place among these if they would not all differ."""
    known = {model: style for model, style in styles.items() if style not in (None, OTHER)}
    return {**known} if len(set(known.values())) == len(styles) else model_styles(styles)


def model_key(styles: Mapping[str, Style]) -> list[tuple[str, Style, bool]]:
    """A legend of models; those without their own style share a line."""
    key = [(model, style, True) for model, style in styles.items()]
    own = [entry for entry in key if entry[1] != OTHER]
    return [*own, ("other models", OTHER, True)] if len(own) < len(key) else own


def legend_handles(key: Sequence[tuple[str, Style, bool]]) -> list[Line2D]:
    """Handles of a legend: (label, style, whether filled)."""
    return [
        Line2D(
            [],
            [],
            linestyle="",
            marker=style.marker,
            markersize=5,
            color=style.colour,
            markerfacecolor=style.colour if filled else "white",
            label=name_text(label),
        )
        for label, style, filled in key
    ]
