"""Where a run's model and data lay: what `robustflow examples` needs to draw a finished run again.

Kept beside the manifest, not in it: paths on one machine are no part of a result, and are not passed on with it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..atomic import write_json
from ..errors import RunError
from ..models import ModelSpec

FILE = "source.json"


@dataclass(frozen=True)
class RunSource:
    """How a run can be set up again.

    Attributes:
        model: by name; None for a Python object, which has none.
        data: of the data set; None where it needs none.
        data_options: of the data set.
    """

    model: ModelSpec | None = None
    data: Path | None = None
    data_options: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write it into a run's folder."""
        model = None if self.model is None else {"name": self.model.name, "options": _plain(self.model.options)}
        data = None if self.data is None else str(self.data.expanduser().absolute())
        options = {
            key: value if isinstance(value, int | float) else str(value) for key, value in self.data_options.items()
        }
        write_json(folder / FILE, {"schema": 1, "model": model, "data": data, "data_options": options})

    @classmethod
    def read(cls, folder: Path) -> RunSource:
        """What was written; an empty source where nothing was (a run of an older version).

        Raises:
            RunError: the file is damaged.
        """
        try:
            found = json.loads((folder / FILE).read_text(encoding="utf-8"))
            spec, data = found["model"], found["data"]
            model = None if spec is None else ModelSpec(str(spec["name"]), tuple(dict(spec["options"]).items()))
            return cls(model, None if data is None else Path(data), dict(found["data_options"]))
        except FileNotFoundError:
            return cls()
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RunError(f"{folder / FILE} is damaged; delete it, and name --model and --data instead") from error


def _plain(options: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Options as JSON knows them; a Python object, which only `evaluate` can be given, as its text.

    >>> _plain([("step", 2), ("root", Path("a")), ("limit", float("inf"))])
    {'step': 2, 'root': 'a', 'limit': 'inf'}
    """
    kept = (str, int, type(None))
    return {
        name: value if isinstance(value, kept) or (isinstance(value, float) and math.isfinite(value)) else str(value)
        for name, value in options
    }
