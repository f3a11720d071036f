"""Convert a matplotlib figure to SVG for a page: one element per panel, with the page's colours and fonts and labelled
marks. The legend is an HTML list below the figure, so that its lines can wrap."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from markupsafe import Markup
from matplotlib.axis import Axis
from matplotlib.markers import MarkerStyle
from matplotlib.transforms import Bbox

from ...core.display import default_style
from ...core.text import plain
from ..figures import figure_bytes
from ..figures.canvas import Mark, MarkedFigure, any_script, settle_layout
from ..figures.styles import BLACK, COLOURS, GRID, OTHER, KeyEntry

_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
_PAGE_COLOURS = {
    BLACK: "currentColor",
    "#ffffff": "var(--page)",
    GRID: "var(--grid)",
    OTHER.colour: "var(--muted)",
    **{colour.lower(): f"var(--chart-{name})" for name, colour in COLOURS.items()},
}
"""Page colour names by the hex colour in matplotlib's SVG output (lower case)."""

_FONT = re.compile(r"font:[^;]*?([\d.]+)px[^;]*")
_FAMILY = re.compile(r"\s*font-family:[^;]*;?")
_LONG_NUMBER = re.compile(r"\d+\.\d{3,}")
_RIM = 2.0
"""Margin around a panel in pixels, because text may be wider in the browser than measured here."""
_MANY = 4
"""Number of panels above which panels may be small."""


@default_style()
def inline_svg(figure: MarkedFigure, prefix: str, page_of: Callable[[str], str | None]) -> Markup:
    """Return the `<svg>` elements of a figure's panels, in a `<div class="plot">` that wraps into several rows. An axis
    that all panels share is drawn in the first one and repeated in the others."""
    settle_layout(figure)  # while every axis takes space
    names = ("xaxis", "yaxis") if len(figure.axes) > 1 else ()
    shared = [name for name in names if len({_scale(getattr(axes, name)) for axes in figure.axes}) == 1]
    for index, axes in enumerate(figure.axes):
        axes.set_gid(f"panel-{index}")
        for name in shared:
            getattr(axes, name).set(gid=name, visible=index == 0)
    root = ElementTree.fromstring(figure_bytes(figure, "svg", live_text=True))
    by_id = {element.get("id"): element for element in root.iter() if element.get("id")}
    for gid, marks in figure.marks.items():
        if gid in by_id:
            _name_marks(by_id[gid], marks, page_of)
    used = {element.get(_XLINK, "")[1:] for element in root.iter()}
    used |= {element.get("clip-path", "")[5:-1] for element in root.iter()} | {*shared}
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        element.text, element.tail = (text if (text or "").strip() else None for text in (element.text, element.tail))
        element.attrib = dict(
            _page_attribute(*item, prefix) for item in element.items() if item[0] != "id" or item[1] in used
        )
    clips = [element for element in root.iter("defs") if element.find("clipPath") is not None]
    boxes = _panel_boxes(figure)
    for name, axes in product(shared, figure.axes):
        getattr(axes, name).set_visible(True)
    name = prefix.removesuffix("-apart")
    plot = ElementTree.Element(
        "div",
        {
            "class": "plot many" if len(boxes) > _MANY else "plot",
            "role": "img",
            "aria-labelledby": f"{name}-title",
            "aria-describedby": f"{name}-text",
            "style": f"--panel: {max(box.width for box in boxes) * 96 / 72:.0f}px",
        },
    )
    for index, box in enumerate(boxes):
        view_box = f"{box.x0:.1f} {box.y0:.1f} {box.width:.1f} {box.height:.1f}"
        svg = ElementTree.SubElement(plot, "svg", {"class": "chart", "viewBox": view_box})
        for axis in shared if index else ():
            moved = f"translate({box.x0 - boxes[0].x0:.2f},{box.y0 - boxes[0].y0:.2f})"
            # above the background, the first element of a panel
            by_id[f"panel-{index}"].insert(1, ElementTree.Element("use", href=f"#{prefix}-{axis}", transform=moved))
        svg.extend([*clips, by_id[f"panel-{index}"]] if index == 0 else [by_id[f"panel-{index}"]])
    return Markup(ElementTree.tostring(plot, encoding="unicode"))


def _scale(axis: Axis) -> tuple[float | str, ...]:
    """Return what an axis shows: two axes with the same scale differ only in their place."""
    ticks = axis.get_majorticklocs()
    return (
        axis.get_label_text(),
        *axis.get_view_interval(),
        *ticks,
        *axis.get_major_formatter().format_ticks(list(ticks)),
    )


def _page_attribute(name: str, value: str, prefix: str) -> tuple[str, str]:
    """Return an attribute with the page's fonts and colours, ids with a prefix, and short numbers."""
    if name == "id":
        return name, f"{prefix}-{value}"
    if name == _XLINK:
        return "href", f"#{prefix}-{value[1:]}"
    if name == "clip-path":
        return name, f"url(#{prefix}-{value[5:]}"
    if name == "style":
        style = _FAMILY.sub("", _FONT.sub(r"font-size: \1px", value)).strip()
        return name, re.sub("#[0-9a-f]{6}", lambda match: page_colour(match[0]), style)
    if name.startswith("data-"):
        return name, value
    return name, _LONG_NUMBER.sub(lambda match: f"{float(match[0]):.2f}", value)


def page_colour(colour: str) -> str:
    """Return the page's colour for a figure colour.

    >>> page_colour("#E69F00")
    'var(--chart-orange)'
    """
    return _PAGE_COLOURS.get(colour.lower(), colour)


def _panel_boxes(figure: MarkedFigure) -> list[Bbox]:
    """Return the bounding box of each panel in the SVG, including labels and names, in points from the upper left. All
    boxes have the same size."""
    around = [0.0, 0.0, 0.0, 0.0]  # left, below, right, above
    for axes in figure.axes:
        with any_script():
            whole = axes.get_tightbbox()
        assert whole is not None
        reach = (axes.bbox.x0 - whole.x0, axes.bbox.y0 - whole.y0, whole.x1 - axes.bbox.x1, whole.y1 - axes.bbox.y1)
        around = [max(one, other) for one, other in zip(around, reach, strict=True)]
    left, below, right, above = (one + _RIM for one in around)
    to_points, height = 72 / figure.dpi, figure.bbox.height
    return [
        Bbox.from_extents(
            (axes.bbox.x0 - left) * to_points,
            (height - axes.bbox.y1 - above) * to_points,
            (axes.bbox.x1 + right) * to_points,
            (height - axes.bbox.y0 + below) * to_points,
        )
        for axes in figure.axes
    ]


def _name_marks(group: ElementTree.Element, marks: Sequence[Mark], page_of: Callable[[str], str | None]) -> None:
    """Label the marks of a group: its `use` elements for collections and lines, or the group itself for bars and
    texts."""
    points = list(group.iter(f"{_SVG}use"))
    pairs = zip(points, marks, strict=True) if len(points) == len(marks) else ((group, mark) for mark in marks[:1])
    for element, mark in pairs:
        page = page_of(mark.model)
        if page is not None:
            element.set("data-page", page)
        element.set("class", "mark" if mark.values else "name")
        if mark.values:
            setting = f" ({plain(mark.setting, 40)})" if mark.setting else ""
            values = ", ".join(f"{what} {value}" for what, value in mark.values)
            element.set("data-label", f"{plain(mark.model)}{setting}: {values}")


_ITEM = Markup('<li><svg class="glyph" viewBox="-6 -6 12 12" aria-hidden="true"><path d="{}" {}></path></svg>{}</li>')


def key_markup(key: Sequence[KeyEntry]) -> Markup:
    """Return a figure's key as an HTML list; "" if it is empty.

    >>> print(key_markup([]))
    <BLANKLINE>
    """
    if not key:
        return Markup("")
    items = Markup("").join(
        _ITEM.format(_shape(style.marker), _paint(page_colour(style.colour), filled), plain(label))
        for label, style, filled in key
    )
    return Markup('<ul class="key">{}</ul>').format(items)


def _shape(marker: str) -> str:
    """Return the outline of a matplotlib marker as the data of an SVG path."""
    style = MarkerStyle(marker)
    outline = style.get_path().transformed(style.get_transform())
    points = np.asarray(outline.to_polygons()[0], float)[:-1]
    return "M" + "L".join(f"{8 * x:.2f} {-8 * y:.2f}" for x, y in points) + "z"


def _paint(colour: str, filled: bool) -> Markup:
    return Markup('style="fill: {}; stroke: {}"').format(colour if filled else "none", colour)
