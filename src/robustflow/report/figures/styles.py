"""Colours and markers of all figures: one style per kind of published model, and one per other model."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from colorsys import hls_to_rgb
from dataclasses import dataclass, field
from typing import Literal

from matplotlib.colors import to_hex
from matplotlib.lines import Line2D

from ...core.text import name_text
from ...stats.lines import LineKey
from ...stats.published.tables import method_of, of_paper

# Okabe and Ito's palette, with four intermediate colours
COLOURS = {
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "green": "#009E73",
    "olive": "#9A8F00",
    "blue": "#0072B2",
    "red": "#D55E00",
    "pink": "#CC79A7",
    "violet": "#6A3D9A",
    "brown": "#8C5A2B",
    "navy": "#24407A",
    "grey": "#999999",
}
"""Colours by the name of the page's variable."""

BLACK, GRID = "#000000", "#dddddd"


@dataclass(frozen=True)
class Style:
    """Colour and marker of a model."""

    colour: str
    marker: str = "o"


KeyEntry = tuple[str, Style, bool]
"""Entry of a legend: (label, style, whether the marker is filled)."""

KIND_STYLES = {
    "CNN-based": Style(COLOURS["pink"]),
    "Transformer-based": Style(COLOURS["green"]),
    "Unsupervised": Style(COLOURS["blue"]),
    "Knowledge-driven": Style(COLOURS["grey"]),
}
"""Styles by model kind, similar to the paper's: purple for CNNs, green for Transformers, blue for unsupervised
models."""

MODEL_STYLES = (
    Style(COLOURS["orange"], "o"),
    Style(COLOURS["violet"], "s"),
    Style(COLOURS["red"], "^"),
    Style(BLACK, "D"),
    Style(COLOURS["sky"], "v"),
    Style(COLOURS["brown"], "P"),
    Style(COLOURS["olive"], "X"),
    Style(COLOURS["navy"], "p"),
)
"""Styles of models that are not in the paper. Their colours differ from the colours of the kinds, so both can appear on
one page."""

OTHER = Style("#666666")
"""Style of what is not a model."""


LegendPlace = Literal["", "upper center", "outside lower center"]


@dataclass(frozen=True)
class FigureStyles:
    """Styling options of a figure: the style of a line, and where the legend is; "" for none."""

    styles: Mapping[LineKey, Style] = field(default_factory=dict)
    legend: LegendPlace = "outside lower center"

    def of(self, lines: Collection[LineKey]) -> dict[LineKey, Style]:
        """Return the style of every line."""
        if of_paper(lines):
            return {line: KIND_STYLES.get(kind_of(line.model), OTHER) for line in lines}
        by_place = model_styles(line.model for line in lines)
        return {line: self.styles.get(line, by_place[line.model]) for line in lines}


PLAIN_STYLES = FigureStyles()
"""A style per kind of published model or per model, with a legend."""


def by_setting(lines: Collection[LineKey]) -> bool:
    """Return whether to draw one panel per setting, as for the paper's values and for a model measured in two
    settings."""
    models = {(line.setting, line.model) for line in lines}
    return of_paper(lines) or len({name for _, name in models}) < len(models)


def kind_of(model: str) -> str:
    """Return the kind of a published model, a key of `KIND_STYLES`; "" for other models.

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
    """Assign a style to each model in order.

    >>> list(model_styles(["DIS", "Mine"]).values())
    [Style(colour='#E69F00', marker='o'), Style(colour='#6A3D9A', marker='s')]
    """
    return {model: nth_style(index) for index, model in enumerate(dict.fromkeys(models))}


def nth_style(index: int) -> Style:
    """Return the style of a model by its place; beyond `MODEL_STYLES`, hues that are a golden angle apart.

    >>> len({nth_style(index).colour for index in range(200)})
    200
    """
    if index < len(MODEL_STYLES):
        return MODEL_STYLES[index]
    lightness = 0.4 + 0.01 * (index % 15)
    return Style(to_hex(hls_to_rgb(index * 0.618034 % 1, lightness, 0.5)), MODEL_STYLES[index % 8].marker)


def distinct_styles(styles: Mapping[str, Style | None]) -> dict[str, Style]:
    """Return the given styles of a few models, or assign styles in order if the given ones are not distinct."""
    known = {model: style for model, style in styles.items() if style is not None}
    return {**known} if len(set(known.values())) == len(styles) else model_styles(styles)


def model_key(styles: Mapping[str, Style]) -> list[KeyEntry]:
    """Build a legend of models."""
    return [(model, style, True) for model, style in styles.items()]


def kind_key(models: Iterable[str]) -> list[KeyEntry]:
    """Build a legend of the kinds of published models."""
    kinds = set(map(kind_of, models))
    return [(kind, style, True) for kind, style in KIND_STYLES.items() if kind in kinds]


def legend_handles(key: Sequence[KeyEntry]) -> list[Line2D]:
    """Make the handles of a legend."""
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
