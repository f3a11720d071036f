"""What the colours and markers of a figure mean, as a list on a page, which breaks its lines where a figure cannot."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from ...text import plain
from ..figures.styles import Style
from .svg import page_colour

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


def key_markup(key: Sequence[tuple[str, Style, bool]]) -> Markup:
    """A list of (label, style, whether the marker is filled); empty for an empty key.

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
