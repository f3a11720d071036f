"""Convert a matplotlib figure to SVG for a page: one element per panel, with the page's colours and fonts and labelled
marks. The legend is an HTML list below the figure, so that its lines can wrap."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence

from markupsafe import Markup
from matplotlib.transforms import Bbox

from ...core.display import default_style
from ...core.text import plain
from ..figures import figure_bytes
from ..figures.canvas import Mark, MarkedFigure, any_script
from ..figures.styles import BLACK, COLOURS, GRID, OTHER, KeyEntry

_SVG, _XLINK = "http://www.w3.org/2000/svg", "{http://www.w3.org/1999/xlink}href"
_COLOURS = {
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
_GEOMETRY = ("d", "x", "y", "points", "transform", "width", "height")


_MANY = 4
"""Number of panels above which panels may be small."""


def page_colour(colour: str) -> str:
    """Return the page's colour for a figure colour.

    >>> page_colour("#E69F00")
    'var(--chart-orange)'
    """
    return _COLOURS.get(colour.lower(), colour)


@default_style()
def inline_svg(figure: MarkedFigure, prefix: str, page_of: Callable[[str], str | None]) -> Markup:
    """Return the `<svg>` elements of a figure's panels, in a `<div class="plot">` that wraps into several rows."""
    for index, axes in enumerate(figure.axes):
        axes.set_gid(f"panel-{index}")
    root = ElementTree.fromstring(figure_bytes(figure, "svg", live_text=True))
    by_id = {element.get("id"): element for element in root.iter() if element.get("id")}
    panels = [by_id[f"panel-{index}"] for index in range(len(figure.axes))]
    for gid, marks in figure.marks.items():
        if gid in by_id:
            _name_marks(by_id[gid], marks, page_of)
    _remove_elements(root, "metadata", "style")
    _share_shapes(root)
    _rename_ids(root, prefix)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        _restyle(element)
    _share_styles(root)
    clips = [element for element in root.iter("defs") if element.find("clipPath") is not None]
    boxes = _panel_boxes(figure)
    plot = ElementTree.Element(
        "div",
        {
            "class": "plot many" if len(panels) > _MANY else "plot",
            "role": "img",
            "aria-labelledby": f"{prefix.removesuffix('-apart')}-title",
            "aria-describedby": f"{prefix.removesuffix('-apart')}-text",
            "style": f"--panel: {max(box.width for box in boxes) * 96 / 72:.0f}px",
        },
    )
    for index, (panel, box) in enumerate(zip(panels, boxes, strict=True)):
        view_box = f"{box.x0:.1f} {box.y0:.1f} {box.width:.1f} {box.height:.1f}"
        svg = ElementTree.SubElement(plot, "svg", {"class": "chart", "viewBox": view_box})
        svg.extend([*clips, panel] if index == 0 else [panel])
    return Markup(ElementTree.tostring(plot, encoding="unicode"))


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


_RIM = 2.0
"""margin around a panel in pixels, because text may be wider in the browser than measured here"""


def mark_text(mark: Mark) -> str:
    """Format the label of a mark, such as "RAFT (OOD): clean EPE 4.29 px, CRE 5.24 px"."""
    setting = f" ({plain(mark.setting, 40)})" if mark.setting else ""
    return f"{plain(mark.model)}{setting}: " + ", ".join(f"{what} {value}" for what, value in mark.values)


def _name_marks(group: ElementTree.Element, marks: Sequence[Mark], page_of: Callable[[str], str | None]) -> None:
    """Label the marks of a group: its `use` elements for collections and lines, or the group itself for bars and
    texts."""
    points = list(group.iter(f"{{{_SVG}}}use"))
    pairs = zip(points, marks, strict=True) if len(points) == len(marks) else ((group, mark) for mark in marks[:1])
    for element, mark in pairs:
        page = page_of(mark.model)
        if page is not None:
            element.set("data-page", page)
        element.set("class", "mark" if mark.values else "name")
        if mark.values:
            element.set("data-label", mark_text(mark))


def _remove_elements(root: ElementTree.Element, *tags: str) -> None:
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in {f"{{{_SVG}}}{tag}" for tag in tags}:
                parent.remove(child)


def _share_shapes(root: ElementTree.Element) -> None:
    """Replace duplicate shapes with references to the first one."""
    first: dict[tuple[str | None, ...], str] = {}
    same: dict[str, str] = {}
    for group in list(root.iter()):
        for shapes in group.findall(f"{{{_SVG}}}defs"):
            for shape in list(shapes):
                name = shape.get("id")
                if name is not None and shape.tag == f"{{{_SVG}}}path":
                    same[name] = first.setdefault((shape.get("d"), shape.get("style")), name)
                    if same[name] != name:
                        shapes.remove(shape)
            if not len(shapes):
                group.remove(shapes)
    for element in root.iter():
        target = element.get(_XLINK)
        if target is not None:
            element.set(_XLINK, f"#{same.get(target[1:], target[1:])}")


def _share_styles(root: ElementTree.Element) -> None:
    """Move attributes shared by all points of a group to the group, and remove whitespace between elements."""
    for group in root.iter():
        for text in ("text", "tail"):
            if not (getattr(group, text) or "").strip():
                setattr(group, text, None)
        styles = {child.get("style") for child in group}
        if group.tag == "g" and "style" not in group.attrib and len(styles) == 1 and {c.tag for c in group} == {"use"}:
            (style,) = styles
            if style:
                group.set("style", style)
                for child in group:
                    del child.attrib["style"]


def _rename_ids(root: ElementTree.Element, prefix: str) -> None:
    """Prefix the ids that are referenced, and remove the others."""
    used: set[str] = set()
    for element in root.iter():
        target = element.attrib.pop(_XLINK, None)
        if target is not None:
            used.add(target[1:])
            element.set("href", f"#{prefix}-{target[1:]}")
        clip = element.get("clip-path")
        if clip is not None:
            used.add(clip[5:-1])
            element.set("clip-path", f"url(#{prefix}-{clip[5:-1]})")
    for element in root.iter():
        name = element.attrib.pop("id", None)
        if name in used:
            element.set("id", f"{prefix}-{name}")


def _restyle(element: ElementTree.Element) -> None:
    style = element.get("style")
    if style is not None:
        style = _FAMILY.sub("", _FONT.sub(r"font-size: \1px", style)).strip()
        element.set("style", re.sub("#[0-9a-f]{6}", lambda match: page_colour(match[0]), style))
    for name in _GEOMETRY:
        value = element.get(name)
        if value is not None:
            element.set(name, _LONG_NUMBER.sub(lambda match: f"{float(match[0]):.2f}", value))


_SHAPES = {
    "o": "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
    "s": "M-3.6 -3.6h7.2v7.2h-7.2z",
    "^": "M0 -4.4L4.4 3.6H-4.4z",
    "v": "M0 4.4L4.4 -3.6H-4.4z",
    "D": "M0 -4.8L4.8 0L0 4.8L-4.8 0z",
    "P": "M-1.6 -4.4h3.2v2.8h2.8v3.2h-2.8v2.8h-3.2v-2.8h-2.8v-3.2h2.8z",
    "X": "M-4.4 -2.2L-2.2 -4.4L0 -2.2L2.2 -4.4L4.4 -2.2L2.2 0L4.4 2.2L2.2 4.4L0 2.2L-2.2 4.4L-4.4 2.2L-2.2 0z",
    "p": "M0 -4.6L4.4 -1.4L2.7 3.7H-2.7L-4.4 -1.4z",
}
_ITEM = Markup('<li><svg class="glyph" viewBox="-6 -6 12 12" aria-hidden="true"><path d="{}" {}></path></svg>{}</li>')


def key_markup(key: Sequence[KeyEntry]) -> Markup:
    """Return a figure's key as an HTML list; "" if it is empty.

    >>> print(key_markup([]))
    <BLANKLINE>
    """
    if not key:
        return Markup("")
    items = Markup("").join(
        _ITEM.format(_SHAPES[style.marker], _paint(page_colour(style.colour), filled), plain(label))
        for label, style, filled in key
    )
    return Markup('<ul class="key">{}</ul>').format(items)


def _paint(colour: str, filled: bool) -> Markup:
    return Markup('style="fill: {}; stroke: {}"').format(colour if filled else "none", colour)
