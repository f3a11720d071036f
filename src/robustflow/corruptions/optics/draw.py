"""Draw figures of a lens: cross-section with rays, spot diagrams, modulation transfer, and PSFs over the field."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...core.display import default_style
from .design import goal_of
from .lens import AIR, DESIGN_WAVELENGTH, IMAGE_RADIUS, Array, Lens, first_order_of, launched, trace
from .merit import FIELDS as MEASURED_FIELDS
from .merit import FREQUENCIES as MEASURED_FREQUENCIES
from .merit import aimed
from .psf_field import FIELDS, SIZE, PsfField
from .render import field_rays, modulation, moments, nominal_rms

COLOURS = ("tab:red", "tab:green", "tab:blue")
_FIELD_POINTS = (0.0, 0.35, 0.7, 1.0)


@default_style()
def lens_figure(lens: Lens, field: PsfField) -> Figure:
    """Draw a one-page overview of a lens: cross-section with rays, spot diagrams, modulation transfer and PSFs."""
    figure = Figure(figsize=(11.0, 8.5), layout="constrained")
    grid = figure.add_gridspec(3, 1, height_ratios=(3.0, 2.2, 2.0))
    upper, middle, lower = (figure.add_subfigure(grid[k]) for k in range(3))
    section, transfer = upper.subplots(1, 2, width_ratios=(1.6, 1.0))
    draw_section(section, lens)
    draw_modulation(transfer, field)
    for axes, place in zip(middle.subplots(1, len(_FIELD_POINTS)), _FIELD_POINTS, strict=True):
        draw_spots(axes, lens, place)
    draw_row(lower.subplots(1, 8), field, titles=True)
    order = first_order_of(lens)
    figure.suptitle(
        f"{lens.name}: {lens.elements} elements, f = {order.focal_length:.1f} mm, f/{lens.f_number:g}, "
        f"half field {lens.half_field:g} deg, RMS radius {nominal_rms(lens):.4f} mm"
    )
    return figure


@default_style()
def contact_sheet(fields: Sequence[tuple[str, PsfField]]) -> Figure:
    """Draw the PSFs of several lenses, one row per lens, from the image centre (left) to the corner (right)."""
    figure = Figure(figsize=(8.8, 1.12 * len(fields) + 0.3), layout="constrained")
    grid = figure.subplots(len(fields), 8, squeeze=False)
    for row, (label, field) in enumerate(fields):
        draw_row(grid[row], field, titles=row == 0)
        grid[row][0].set_ylabel(label, fontsize=8)
    return figure


@default_style()
def profile_figure(fields: Sequence[tuple[int, PsfField]]) -> Figure:
    """Plot the blur over the field per severity and colour: our PSFs as lines, the measured reference PSFs as
    points.
    """
    figure = Figure(figsize=(2.2 * len(fields) + 0.6, 4.2), layout="constrained")
    grid = figure.subplots(2, len(fields), squeeze=False, sharex=True)
    place, frequency = np.linspace(0.0, 1.0, FIELDS), 1
    for column, (severity, field) in enumerate(fields):
        _, goal = goal_of(severity)
        tangential, sagittal = modulation(field, MEASURED_FREQUENCIES[frequency : frequency + 1])
        radius = moments(field).rms
        upper, lower = grid[:, column]
        for colour, name in enumerate(COLOURS):
            upper.plot(place, radius[:, colour], color=name)
            upper.plot(MEASURED_FIELDS, goal.rms[:, colour], "o", color=name, markersize=3)
            lower.plot(place, tangential[:, colour, 0], color=name)
            lower.plot(place, sagittal[:, colour, 0], "--", color=name)
            lower.plot(MEASURED_FIELDS, goal.tangential[:, colour, frequency], "o", color=name, markersize=3)
            lower.plot(MEASURED_FIELDS, goal.sagittal[:, colour, frequency], "o", color=name, markersize=3, mfc="none")
        upper.set_title(f"severity {severity}", fontsize=9)
        upper.set_ylim(0.0, None)
        lower.set_ylim(0.0, 1.0)
        lower.set_xlabel("field", fontsize=8)
        for axes in (upper, lower):
            axes.tick_params(labelsize=7)
    grid[0][0].set_ylabel("RMS radius (px)", fontsize=8)
    grid[1][0].set_ylabel("modulation at 0.04 / px", fontsize=8)
    return figure


@default_style()
def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format given by the suffix (.png, .pdf, .svg)."""
    dated = {".png": "Creation Time", ".svg": "Date"}.get(path.suffix, "CreationDate")
    figure.savefig(path, dpi=110, metadata={dated: None})


def draw_section(axes: Axes, lens: Lens) -> None:
    """Draw the meridional section: surfaces, rims, stop, sensor, and rays from three field points."""
    curvature, conic, radius = lens.column("curvature"), lens.column("conic"), lens.column("semi_diameter")
    vertex = np.concatenate([[0.0], np.cumsum(lens.column("thickness"))])
    glass_before = AIR
    for k, surface in enumerate(lens.surfaces):
        # The rim of an element is a cylinder with the diameter of the larger of its two faces.
        rim = radius[k]
        if surface.glass != AIR:
            rim = max(rim, radius[k + 1])
        if glass_before != AIR:
            rim = max(rim, radius[k - 1])
        y = np.linspace(-rim, rim, 81)
        z = vertex[k] + _sag(curvature[k], conic[k], y)
        if k == lens.stop:
            for sign in (1, -1):
                axes.plot([vertex[k]] * 2, [sign * rim, sign * rim * 1.35], color="black", linewidth=2.5)
        else:
            axes.plot(z, y, color="black", linewidth=1.0)
        if surface.glass != AIR:
            wide = max(radius[k], radius[k + 1])
            for edge in (wide, -wide):
                ends = [vertex[j] + float(_sag(curvature[j], conic[j], np.array(edge))) for j in (k, k + 1)]
                axes.plot(ends, [edge, edge], color="black", linewidth=1.0)
        glass_before = surface.glass
    axes.plot([vertex[-1]] * 2, [-IMAGE_RADIUS, IMAGE_RADIUS], color="black", linewidth=1.5)
    for place, colour in zip((0.0, 0.7, 1.0), ("tab:blue", "tab:green", "tab:red"), strict=True):
        for z, y in _fan(lens, place, vertex):
            axes.plot(z, y, color=colour, linewidth=0.6)
    axes.set_aspect("equal")
    axes.set_xlabel("mm")
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.set_yticks([])


def _sag(c: float, k: float, r: Array) -> Array:
    under = np.maximum(1.0 - (1.0 + k) * c * c * r * r, 0.0)
    return np.asarray(c * r * r / (1.0 + np.sqrt(under)))


def _fan(lens: Lens, place: float, vertex: Array) -> list[tuple[Array, Array]]:
    """Return z and y in mm along seven meridional rays from a field point, starting in front of the lens."""
    tangent = place * lens.field_tangent
    _, y, _ = aimed(lens, np.array([tangent]))
    heights = np.linspace(y[2], y[1], 7)
    path, last = trace(lens, launched(np.zeros(7), heights, np.full(7, tangent)), DESIGN_WAVELENGTH)
    before = -0.15 * vertex[-1]
    return [
        (
            np.concatenate([[before], path[:, 2, ray] + vertex[:-1], [vertex[-1]]]),
            np.concatenate([[heights[ray] + before * tangent], path[:, 1, ray], [last.y[ray]]]),
        )
        for ray in range(7)
        if last.alive[ray]
    ]


def draw_spots(axes: Axes, lens: Lens, place: float) -> None:
    """Draw the red, green and blue spot diagrams for a field point, in pixels relative to the green centroid."""
    rays = field_rays(lens, np.array([place]), 12, 24, samples=3)[0]
    green = rays[1]
    middle = (green[1] * green[2]).sum() / green[2].sum()
    for colour, (x, y, weight) in zip(COLOURS, rays, strict=True):
        passed = weight > 0.0
        both = np.concatenate([x[passed], -x[passed]])
        axes.plot(both, np.tile(y[passed] - middle, 2), ".", color=colour, markersize=1.0, alpha=0.5)
    axes.set_xlim(-SIZE / 2, SIZE / 2)
    axes.set_ylim(SIZE / 2, -SIZE / 2)
    axes.set_aspect("equal")
    axes.set_title(f"spots at field {place:g} (px)", fontsize=9)
    axes.tick_params(labelsize=7)


def draw_modulation(axes: Axes, field: PsfField) -> None:
    """Plot the modulation transfer for green at four field points: tangential as solid lines, sagittal as dashed
    lines.
    """
    frequencies = np.linspace(0.0, 0.5, 101)
    tangential, sagittal = modulation(field, frequencies)
    for number, place in enumerate(_FIELD_POINTS):
        row = round(place * (FIELDS - 1))
        axes.plot(frequencies, tangential[row, 1], color=f"C{number}", label=f"field {place:g}")
        axes.plot(frequencies, sagittal[row, 1], color=f"C{number}", linestyle="--")
    axes.set_xlabel("cycles per pixel")
    axes.set_ylabel("modulation (green; dashed: sagittal)")
    axes.set_xlim(0.0, 0.5)
    axes.set_ylim(0.0, 1.0)
    axes.legend(fontsize=8)


def draw_row(row: Sequence[Axes], field: PsfField, titles: bool) -> None:
    """Draw the PSFs at evenly spaced field points as colour images with a gamma of 1/2.2, each scaled to its own
    peak.
    """
    for axes, place in zip(row, np.linspace(0.0, 1.0, len(row)), strict=True):
        psf = field.stack[round(place * (FIELDS - 1))].transpose(1, 2, 0)
        axes.imshow((np.clip(psf, 0.0, None) / psf.max()) ** (1 / 2.2), interpolation="nearest")
        axes.set_xticks([])
        axes.set_yticks([])
        if titles:
            axes.set_title(f"field {place:.2f}", fontsize=8)
