"""Croissant metadata: the rows of a run as a dataset for search engines and loaders."""

from __future__ import annotations

import hashlib
from pathlib import PurePosixPath
from typing import Any

import polars as pl

from ...atomic import json_bytes
from ...metrics.rows import ROW_SCHEMA
from ...records.rows_text import rows_to_text
from ...text import file_name
from .facts import RunFacts

_ROWS = "rows.csv"
_TYPES: dict[Any, str] = {pl.String: "sc:Text", pl.Int64: "sc:Integer", pl.Float64: "sc:Float"}
_SHORT = ("citeAs", "column", "conformsTo", "extract", "field", "fileObject", "recordSet", "source")
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "sc": "https://schema.org/",
    "dct": "http://purl.org/dc/terms/",
    **{name: f"cr:{name}" for name in _SHORT},
    "conformsTo": "dct:conformsTo",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
}


def croissant_files(facts: RunFacts) -> dict[PurePosixPath, bytes]:
    """Return `croissant.json` and the file that it describes, `rows.csv`."""
    rows = rows_to_text(facts.run.rows)
    metadata = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": file_name(f"robustflow {facts.name} {facts.title}"),
        "description": (
            f"Errors of the optical flow of {facts.name} on {facts.title}, clean and corrupted: sums and counts, one "
            f"row per pair, corruption and severity, measured by RobustFlow {facts.version} (run {facts.digest}). "
            + " ".join(facts.warnings)
        ).strip(),
        "version": "1.0.0",
        **({"datePublished": facts.finished.date().isoformat()} if facts.finished else {}),
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": _ROWS,
                "name": _ROWS,
                "contentUrl": _ROWS,
                "contentSize": f"{len(rows)} B",
                "encodingFormat": "text/csv",
                "sha256": hashlib.sha256(rows).hexdigest(),
            }
        ],
        "recordSet": [{"@type": "cr:RecordSet", "@id": "rows", "name": "rows", "field": [*map(_field, ROW_SCHEMA)]}],
    }
    return {PurePosixPath("croissant.json"): json_bytes(metadata), PurePosixPath(_ROWS): rows}


def _field(column: str) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"rows/{column}",
        "name": column,
        "dataType": _TYPES[ROW_SCHEMA[column]],
        "source": {"fileObject": {"@id": _ROWS}, "extract": {"column": column}},
    }
