"""`report.html`: one run as a self-contained page that needs no network."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, select_autoescape

from ..runner.plan import left_out_sentence

if TYPE_CHECKING:
    from ..runner.result import Result

_METRICS = {"epe": "EPE", "cre": "CRE", "crer": "CREr", "rcre": "RCRE", "fl": "Fl-all %", "wauc": "WAUC %"}


def render_report(result: Result) -> str:
    """The report of a run. Names and texts of the run are untrusted: everything is escaped."""
    environment = Environment(loader=PackageLoader("robustflow.report"), autoescape=select_autoescape(default=True))
    environment.filters["cell"] = lambda value: "–" if value is None else f"{value:.3f}"
    summary = result.summary
    shown = {m: label for m, label in _METRICS.items() if getattr(summary, m) is not None}
    return environment.get_template("report.html").render(
        result=result,
        summary=summary,
        metrics=shown,
        levels=summary.severities(),
        heat=_heat(summary.table("rcre")),
        facts=_facts(result),
    )


def _heat(table: Any) -> list[dict[str, Any]]:
    """RCRE by corruption and severity, each cell with its share of the largest value."""
    levels = [column for column in table.columns if column.isdigit()]
    values = [value for level in levels for value in table[level] if value is not None]
    top = max(values, default=0.0) or 1.0
    return [
        {"name": row["corruption"], "cells": [(row[level], (row[level] or 0.0) / top) for level in levels]}
        for row in table.iter_rows(named=True)
    ]


def _facts(result: Result) -> dict[str, Any]:
    manifest = result.manifest
    packages = ", ".join(f"{name} {version}" for name, version in manifest["environment"]["packages"].items())
    model = ", ".join(f"{key}: {value}" for key, value in manifest["identity"]["model"].items())
    return {
        "model": model,
        "benchmark": manifest["identity"]["benchmark"],
        "samples": len(manifest["samples"]),
        "seed": manifest["identity"]["seed"],
        "variant of the corruptions": manifest["identity"]["variant"],
        "severity scale": manifest["identity"].get("severity_scale", "paper"),
        **({"left out": left_out_sentence(result.left_out)} if result.left_out else {}),
        "run": manifest["identity_digest"],
        "packages": packages,
    }
