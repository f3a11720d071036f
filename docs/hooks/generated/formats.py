"""The file formats that users read: rows, summary.json, manifest.json, records; fields and types from their
declarations.
"""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from robustflow.metrics import measures, regions, rows
from robustflow.run import summary
from robustflow.run.records import format

from .tables import table


def files() -> dict[str, str]:
    """Make the four pages."""
    return {
        "reference/rows.md": _rows(),
        "reference/summary.md": _summary(),
        "reference/manifest.md": _manifest(),
        "reference/record.md": _record(),
    }


def _rows() -> str:
    doc = inspect.getdoc(rows) or ""
    listed = []
    for name, column in rows.COLUMNS.items():
        region = next((r for r in regions.REGIONS if name.endswith(f"_{r}")), "")
        listed.append((f"`{name}`", column.kind.__name__, region and f"`{region}`", column.meaning))
    return "\n\n".join(
        [
            "# Rows",
            "`RUN/rows/*.parquet`, `Result.rows`, and `rows.csv` of a record. "
            f"Schema version {rows.ROW_SCHEMA_VERSION}.",
            doc.partition("\n\n")[2],
            "## Columns",
            table(("column", "type", "region", "meaning"), listed),
            "No two rows of a run share " + ", ".join(f"`{name}`" for name in rows.ROW_KEY) + ".",
            "## Regions",
            _attributes_or_text(regions),
        ]
    )


def _summary() -> str:
    metrics = [(f"`{name}`", *_in_words(name)) for name in measures.METRICS]
    parts = [
        "# summary.json",
        f"The means of a run, version {summary.SUMMARY_VERSION}. In Python: `Result.frame` (one table) and "
        "`Result.document()` (as in the file).",
        table(("field", "unit", "meaning"), metrics),
        "These fields are means over the corruptions in `averaged_over`. The same fields appear in `clean`, in each "
        "entry of `corruptions`, `families` and `regions`, and in `paper`, the means over exactly the paper's "
        "corruptions. An entry of `corruptions` also has `family`, `severities`, and `by_severity`, a list for each "
        "metric; an entry of `regions` has `share`, the percentage of the valid pixels, `epe_clean` and `fl_clean`. "
        "`pooled` contains all of this over the pixels of all images at once. `epe_clean`, `clean_flow_length` and "
        "`photometric_still` are means over the clean frames; `version`, `row_schema`, `averaging`, `run` and "
        "`setting` identify the run.",
    ]
    for model in (summary.Measured, summary.MissingCells):
        parts += _model(model)
    return "\n\n".join(parts)


def _in_words(metric: str) -> tuple[str, str]:
    """The unit of a metric and what it is."""
    measure = measures.MEASURES[metric]
    return measure.unit, ": ".join(filter(None, (measure.label, measure.explanation)))


def _manifest() -> str:
    parts = [
        "# manifest.json",
        "The configuration of a run. A record contains the fields below; a run's folder also contains the command line "
        "and the machine's name and system, which `robustflow record pack` omits.",
    ]
    for model in (format.Manifest, *_used_by(format.Manifest)):
        parts += _model(model)
    return "\n\n".join(parts)


def _record() -> str:
    parts = [
        "# Records",
        f"`record.json` of a `.robustflow` file, version {format.VERSION}. [The guide](../records.md) describes the "
        "other entries of the file, what `record verify` checks, and what it cannot show. See also "
        "[`manifest.json`](manifest.md) and the [columns of `rows.csv`](rows.md).",
    ]
    parts += _model(format.Record)
    return "\n\n".join(parts)


def _model(model: type[BaseModel]) -> list[str]:
    """A heading, the first sentence of the docstring, and the fields, including those of a base class."""
    doc = inspect.getdoc(model) or ""
    meanings: dict[str, str] = {}
    for base in reversed(model.__mro__):
        meanings |= attributes(base.__doc__ or "")
    listed = []
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else f"`{field.get_default()!r}`"
        listed.append((f"`{field.alias or name}`", f"`{type_name(field.annotation)}`", default, meanings.get(name, "")))
    filled = any(row[3] for row in listed)
    heading = ("field", "type", "default", "meaning") if filled else ("field", "type", "default")
    intro = doc.partition("\n\nAttributes:")[0]
    return [f"## {model.__name__}", intro, table(heading, [row if filled else row[:3] for row in listed])]


def _used_by(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """The models among the field types of a model, in order, each once."""
    seen: dict[type[BaseModel], None] = {}
    for field in model.model_fields.values():
        for kind in (field.annotation, *typing.get_args(field.annotation)):
            if inspect.isclass(kind) and issubclass(kind, BaseModel) and kind not in seen:
                seen[kind] = None
                yield kind
                yield from (each for each in _used_by(kind) if each not in seen)


def attributes(doc: str) -> dict[str, str]:
    """Meanings by name from the section "Attributes:" of a docstring."""
    section = inspect.cleandoc(doc).partition("Attributes:\n")[2].partition("\n\n")[0]
    out = {}
    for entry in re.split(r"\n    (?=\S)", "\n" + section):
        names, _, meaning = entry.partition(":")
        for name in names.split(","):
            if name.strip():
                out[name.strip()] = " ".join(meaning.split())
    return out


def type_name(kind: Any) -> str:
    """A type as written in Python."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return type_name(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return " | ".join(type_name(each) for each in arguments)
    if origin is typing.Literal:
        return " | ".join(repr(each) for each in arguments)
    if origin is not None:
        return f"{origin.__name__}[{', '.join(type_name(each) for each in arguments)}]"
    return "None" if kind is type(None) else str(getattr(kind, "__name__", kind))


def _attributes_or_text(module: Any) -> str:
    return inspect.getdoc(module) or ""
