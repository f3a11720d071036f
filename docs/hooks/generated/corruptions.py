"""A page for each corruption: equation, severities, generated pictures, and the effect on flow."""

from __future__ import annotations

import inspect
import io
import os
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from statistics import fmean
from typing import Any

import numpy as np
from PIL import Image

from robustflow.corruptions import CORRUPTIONS, FAMILIES, PAPER_ORDER, SEVERITIES, load_corruption
from robustflow.corruptions.registry import CLIP, SHIPPED, heading_of
from robustflow.corruptions.scale import calibrated_severities
from robustflow.media.colours import flow_colours, flow_radius
from robustflow.stats.published.tables import published_lines

from . import families
from .corruption_notes import NOTES
from .demonstration import Numbers, Seen, clean_pair, seen
from .tables import table

FOLDER = "corruptions"
_WIDTH = 494
"""Pictures have two thirds of the demonstration pair's size."""


def files() -> dict[str, str | bytes]:
    """Every page with its pictures, the pages of the families, and the page that lists them; uses all processors for
    half a minute.
    """
    out: dict[str, str | bytes] = {f"{FOLDER}/index.md": _index()}
    for clip, name in ((False, "pair"), (True, "clip")):
        frames, flow, radius = _clean(clip)
        out[f"{FOLDER}/images/clean_{name}.webp"] = picture(frames[0])
        out[f"{FOLDER}/images/clean_{name}_flow.webp"] = picture(flow_colours(flow, radius))
    slowest_first = sorted(SHIPPED, key=lambda name: name not in (*CLIP, "psf_blur"))
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        measured = {}
        for name, (made, numbers) in zip(slowest_first, pool.map(_made, slowest_first), strict=True):
            out |= made
            measured[name] = numbers
    return out | families.files(measured)


def _made(name: str) -> tuple[dict[str, str | bytes], Numbers]:
    """The page of one corruption with its pictures and its measured errors."""
    cells = seen(name)
    out: dict[str, str | bytes] = {f"{FOLDER}/{name}.md": page(name, cells)}
    for cell in cells:
        flow = flow_colours(cell.flow, _clean(name in CLIP)[2])
        out[f"{FOLDER}/images/{name}_{cell.severity}.webp"] = picture(cell.frame)
        out[f"{FOLDER}/images/{name}_{cell.severity}_flow.webp"] = picture(flow)
    return out, Numbers(tuple(cell.epe for cell in cells), cells[0].epe_clean)


def navigation() -> list[Any]:
    """The list, then the families with their own page and their corruptions."""
    by_family = [
        {family: [families.path(family), *({name: f"{FOLDER}/{name}.md"} for name in names)]}
        for family, names in FAMILIES.items()
    ]
    others = [name for name in SHIPPED if name not in PAPER_ORDER]
    return [f"{FOLDER}/index.md", *by_family, {"besides": [{name: f"{FOLDER}/{name}.md"} for name in others]}]


def page(name: str, cells: list[Seen]) -> str:
    """The page of one corruption."""
    note, one = NOTES[name], load_corruption(name)
    family = heading_of(name)
    if name in PAPER_ORDER:
        family = f"[{family}]({family}/index.md)"
    traits = [f"Family: {family}."]
    if name in CLIP:
        traits.append("Needs the whole clip.")
    elif one.temporal:
        traits.append("Temporal: the effect changes from frame to frame.")
    if name not in PAPER_ORDER:
        traits.append("Not among the paper's 24.")
    parts = [
        f"# {name}",
        " ".join(traits),
        _text(inspect.getdoc(CORRUPTIONS.get(name)) or ""),
        "## Equation",
        f"$${note.equation}$$",
        note.where,
        "Frames are 8-bit RGB; results are clipped and rounded once. Where the paper and its code differ, "
        "[the list of differences](../design/discrepancies.md) states which one is followed.",
        "## Severities",
        _severities(name),
        "## Effect on flow",
        note.effect,
        _measured(name, cells),
        *_published(name),
        "## Pictures",
        _pictures(name, cells),
    ]
    if name not in CLIP:
        parts += ["## Use", _use(name)]
    return "\n\n".join(parts) + "\n"


def _text(doc: str) -> str:
    """A docstring without its sections, doctests and notes on arguments."""
    kept = []
    for paragraph in doc.split("\n\n"):
        if paragraph.startswith((">>>", "Raises:", "Args:")):
            break
        kept.append(paragraph)
    return "\n\n".join(kept)


def _severities(name: str) -> str:
    variants = {"severity": list(SEVERITIES)}
    default = load_corruption(name).severities
    for number, parameter in enumerate(NOTES[name].parameters):
        variants[parameter] = [value[number] if isinstance(value, tuple) else value for value in default]
    reference = load_corruption(name, "reference").severities
    if reference != default:
        variants['in the variant "reference"'] = [_number(value) for value in reference]
    calibrated = calibrated_severities(name)
    if any(value is not None for value in calibrated):
        variants["on the calibrated scale"] = [_number(value) for value in calibrated]
    rows = zip(*([_number(v) for v in column] for column in variants.values()), strict=True)
    return table(list(variants), rows) + "\n\nThe calibrated scale is [explained here](../severity-scales.md)."


def _number(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(_number(each) for each in value)
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and value >= 100_000:
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _measured(name: str, cells: list[Seen]) -> str:
    where = (
        "a clip made of one photograph: 64 frames of 360x240 at 960 per second, each shifted by a quarter of a pixel; "
        "the pair is 32 frames apart"
        if name in CLIP
        else "the demonstration pair (`robustflow run --model dis`)"
    )
    clean = cells[0].epe_clean
    intro = f"OpenCV's DIS on {where}. Its end-point error on the clean frames is {clean:.2f} px."
    if name == "bit_error":
        intro += " Errors occur once per given number of bytes, so a clip this short has few errors or none."
    rows = [(c.severity, f"{c.ssim:.2f}", f"{c.epe:.2f}", f"{c.epe - clean:.2f}", f"{c.rcre:.2f}") for c in cells]
    heading = ("severity", "SSIM", "EPE (px)", "CRE (px)", "RCRE (px)")
    if load_corruption(name).truth == "none":
        rows, heading = [(*row[:2], row[-1]) for row in rows], (*heading[:2], heading[-1])
    return "\n\n".join([intro, table(heading, rows), "[Metrics](../design/metrics.md) defines the columns."])


def _published(name: str) -> list[str]:
    """A sentence about the paper's models."""
    if name not in PAPER_ORDER:
        return []
    benchmark, metric = ("gopro-fc", "rcre") if name in CLIP else ("kitti-fc", "cre")
    means = _published_means(benchmark, metric)
    order = list(means)
    title = "GoPro-FC" if name in CLIP else "KITTI-FC"
    return [
        f"In the paper's table of {title}, the mean {metric.upper()} of its out-of-domain models under this corruption "
        f"is {means[name]:.2f} px: rank {order.index(name) + 1} of {len(order)}, where 1 is the worst."
    ]


@cache
def _published_means(benchmark: str, metric: str) -> dict[str, float]:
    """Mean over the paper's out-of-domain models by corruption, the worst first."""
    lines = published_lines().items()
    measured = [line.by_corruption(metric) for key, line in lines if (key.benchmark, key.setting) == (benchmark, "OOD")]
    means = {
        name: fmean(values)
        for name in PAPER_ORDER
        if (values := [numbers[name] for numbers in measured if name in numbers])
    }
    return dict(sorted(means.items(), key=lambda item: -item[1]))


def _pictures(name: str, cells: list[Seen]) -> str:
    kind = "clip" if name in CLIP else "pair"
    rows = [
        '<div class="pictures" markdown="0">',
        _figure(f"images/clean_{kind}.webp", "The clean first frame", "clean"),
        _figure(f"images/clean_{kind}_flow.webp", "Flow of DIS on the clean frames", "flow on clean frames"),
    ]
    for cell in cells:
        what = f"severity {cell.severity}"
        second = ", second frame" if cell.index else ""
        rows.append(_figure(f"images/{name}_{cell.severity}.webp", f"A frame under {name}, {what}", what + second))
        rows.append(_figure(f"images/{name}_{cell.severity}_flow.webp", f"Flow of DIS, {what}", f"flow at {what}"))
    rows.append("</div>")
    return "\n".join(rows)


def _figure(path: str, alt: str, caption: str) -> str:
    return f'<figure><img src="{path}" alt="{alt}" loading="lazy"><figcaption>{caption}</figcaption></figure>'


def _use(name: str) -> str:
    depth, given = (_DEPTH, ", depth=depth") if load_corruption(name).needs_depth else ("", "")
    return f"""```bash
robustflow run --model dis --corruptions {name} --no-examples
```

```python
import numpy as np

import robustflow as rf

frame1 = np.full((48, 64, 3), 90, np.uint8)  # RGB uint8
frame2 = np.full((48, 64, 3), 94, np.uint8)
{depth}corrupted1, corrupted2 = rf.corrupt(frame1, frame2, "{name}", severity=3, seed=0{given})
```"""


_DEPTH = """\
metres, known = np.full((48, 64), 20, np.float32), np.ones((48, 64), bool)  # of both frames
camera = rf.Camera((60, 60), (31.5, 23.5), np.eye(3), np.zeros(3))
depth = rf.SceneDepth((metres, metres), (known, known), camera)
"""


def _index() -> str:
    parts = [
        "# Corruptions",
        "The paper's 24 corruptions at five severities, in the order of its tables; and further ones that its means "
        "do not include: `elastic_transform` from its appendix and those [in three dimensions](../depth.md). Each is "
        "generated on the fly from a seed, with the same bytes on every machine.",
    ]
    for family, names in {**FAMILIES, "besides": tuple(n for n in SHIPPED if n not in PAPER_ORDER)}.items():
        title = family.capitalize()
        parts.append(f"## [{title}]({family}/index.md)" if family in FAMILIES else f"## {title}")
        cards = [
            f'<figure><a href="{name}.html"><img src="images/{name}_3.webp" alt="A frame under {name}" loading="lazy">'
            f"</a><figcaption>{name}</figcaption></figure>"
            for name in names
        ]
        links = ", ".join(f"[`{name}`]({name}.md)" for name in names)
        parts += ["\n".join(['<div class="pictures" markdown="0">', *cards, "</div>"]), links]
    return "\n\n".join(parts) + "\n"


def picture(image: Any) -> bytes:
    """Encode an RGB uint8 array as a small WebP file."""
    shown = Image.fromarray(np.ascontiguousarray(image))
    if shown.width > _WIDTH:
        shown = shown.resize((_WIDTH, round(shown.height * _WIDTH / shown.width)), Image.Resampling.LANCZOS)
    file = io.BytesIO()
    shown.save(file, "WEBP", quality=80, method=2)
    return file.getvalue()


@cache
def _clean(clip: bool) -> tuple[Any, Any, float]:
    """Frames, DIS's flow on them, and the shared radius of flow colours for pictures of one kind."""
    frames, truth, valid, flow = clean_pair(clip)
    return frames, flow, flow_radius(truth, valid)
