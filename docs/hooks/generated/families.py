"""A page for each family of corruptions: description, its corruptions side by side, and the paper's models under it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import fsum

from robustflow.corruptions import FAMILIES, SEVERITIES
from robustflow.corruptions.registry import CLIP
from robustflow.stats.published.tables import published_lines

from .demonstration import Numbers
from .tables import table

FOLDER = "corruptions"

ABOUT = {
    "digital": "Effects of software on a finished picture: compression, coarse pixels, and changes of contrast "
    "or of colour. Both frames are treated alike.",
    "illumination": "More or less light over the whole frame. `over_exposure` and `under_exposure` change only one "
    "of the two frames, which breaks the assumption that a point keeps its brightness.",
    "weather": "Effects between the camera and the scene, or on the lens. Fog reduces contrast, frost and spatter "
    "stay still in front of a moving scene, and snow moves independently of the scene.",
    "noise": "Sensor noise: it is independent for each pixel and each frame, so the best match may no longer be the "
    "right one.",
    "blur": "Optics or motion spread the light of one point over several pixels. Fine detail, which matching depends "
    "on, is lost; strong edges remain.",
    "video": "Effects of encoding and transmitting a clip. They need the whole clip, because an error persists until "
    "the next key frame.",
}
"""A property shared by the corruptions of a family."""


def files(measured: Mapping[str, Numbers]) -> dict[str, str | bytes]:
    """Make the pages from DIS's errors under each corruption."""
    return {path(family): page(family, {name: measured[name] for name in names}) for family, names in FAMILIES.items()}


def path(family: str) -> str:
    """Path of a family's page."""
    return f"{FOLDER}/{family}/index.md"


def page(family: str, measured: Mapping[str, Numbers]) -> str:
    """The page of one family."""
    cards = [
        f'<figure><a href="../{name}.html"><img src="../images/{name}_3.webp" alt="A frame under {name}" '
        f'loading="lazy"></a><figcaption>{name}</figcaption></figure>'
        for name in measured
    ]
    parts = [
        f"# {family.capitalize()}",
        ABOUT[family],
        "\n".join(['<div class="pictures" markdown="0">', *cards, "</div>"]),
        "The pictures show severity 3. Each corruption has a page: "
        + ", ".join(f"[`{name}`](../{name}.md)" for name in measured)
        + ".",
        *_measured(measured),
        "## The paper's models",
        _published(family),
        f"To see the family's corruptions separately on a leaderboard, choose {family.capitalize()} under Columns, or "
        f"add `#columns={family}` to the address.",
    ]
    return "\n\n".join(parts) + "\n"


def _measured(measured: Mapping[str, Numbers]) -> list[str]:
    """DIS's error at each severity; measurements on the pair and on the clip are not averaged together."""
    parts = ["## Effect on flow"]
    for clip, where in ((False, "the demonstration pair"), (True, "a clip made of one photograph")):
        chosen = {name: numbers for name, numbers in measured.items() if (name in CLIP) == clip}
        if not chosen:
            continue
        lines = {f"[`{name}`](../{name}.md)": numbers.epe for name, numbers in chosen.items()}
        if len(chosen) > 1:
            lines["**mean**"] = tuple(_mean(errors) for errors in zip(*lines.values(), strict=True))
        rows = [(label, *(f"{value:.2f}" for value in (*errors, _mean(errors)))) for label, errors in lines.items()]
        clean = next(iter(chosen.values())).epe_clean
        parts += [
            f"EPE of OpenCV's DIS on {where}, in pixels; {clean:.2f} on the clean frames.",
            table(("corruption", *map(str, SEVERITIES), "mean"), rows),
        ]
    return parts


def _published(family: str) -> str:
    """Every model's mean over the family, by setting, the lowest first."""
    benchmark, metric, title = (
        ("gopro-fc", "rcre", "GoPro-FC") if family == "video" else ("kitti-fc", "cre", "KITTI-FC")
    )
    lines = {key: line for key, line in published_lines().items() if key.benchmark == benchmark}
    means = {(key.setting, key.model): line[metric, family, None]["value"] for key, line in lines.items()}
    order = ["knowledge", "OOD", "ID"]
    lowest = sorted(means, key=lambda key: (order.index(key[0]), means[key]))
    rows = [(model, setting, f"{means[setting, model]:.2f}") for setting, model in lowest]
    intro = f"Mean {metric.upper()} over the family on {title}, in pixels, from the published values; lower is better. "
    more = "Rows with different settings are not comparable; see the [glossary](../../glossary.md)."
    return f"{intro}{more}\n\n{table(('model', 'setting', f'{metric.upper()} (px)'), rows)}"


def _mean(values: Sequence[float]) -> float:
    return fsum(values) / len(values)
