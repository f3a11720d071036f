"""Each name has one meaning: no two classes of the package share a name."""

import ast
from collections import defaultdict
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "src" / "robustflow"
NETWORKS = SOURCE / "models" / "networks"
"""The blocks of a network are named after the original's, and most originals have an `Attention`."""


def classes_by_name(source: Path, without: Path) -> dict[str, list[str]]:
    """Files that define each class at their top level; a leading underscore does not make a name different."""
    places = defaultdict(list)
    for path in sorted(source.rglob("*.py")):
        if without not in path.parents:
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef):
                    places[node.name.lstrip("_")].append(str(path.relative_to(source)))
    return places


def test_no_two_classes_share_a_name():
    places = classes_by_name(SOURCE, NETWORKS)
    assert len(places) > 200
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
