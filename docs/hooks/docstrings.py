"""Prepare this project's docstrings for griffe: doctests become code blocks, and return values get the
annotated type.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Class, Docstring, Extension, Object

_DOCTEST = re.compile(r"(?:^>>> .*\n?(?:^(?!\s*$).*\n?)*)+", re.MULTILINE)
_RETURNS = re.compile(r"^(Returns|Yields):\n    (?=\S)", re.MULTILINE)
_SEVERAL = re.compile(r"^(    )(\w+(?:, \w+)+): (.*(?:\n     +\S.*)*)", re.MULTILINE)

_ENTRY = re.compile(r"^    (\w+(?:, \w+)*): (.*\n(?:     +.*\n)*)", re.MULTILINE)


class Docstrings(Extension):
    """Rewrites docstrings before they are parsed as Google style."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Rewrite the docstring of one module, class, function or attribute."""
        if obj.docstring is None:
            return
        text = _DOCTEST.sub(lambda match: f"```pycon\n{match[0].rstrip()}\n```\n", obj.docstring.value)
        returns = getattr(obj, "returns", None)
        if returns is not None:
            text = _RETURNS.sub(lambda match: f"{match[0]}{returns}: ", text)
        obj.docstring.value = _each_apart(text)

    def on_class(self, *, cls: Class, **_: Any) -> None:
        """Move the entries of a class's section "Attributes:" to the fields' own docstrings."""
        if cls.docstring is None:
            return
        head, sign, rest = cls.docstring.value.partition("\nAttributes:\n")
        section, gap, after = rest.partition("\n\n")
        if not sign:
            return
        left = []
        for names, meaning in _ENTRY.findall(section + "\n"):
            for name in names.split(", "):
                field = cls.members.get(name)
                if field is not None and field.is_attribute and field.docstring is None:
                    field.docstring = Docstring(" ".join(meaning.split()), parent=field)
                elif field is None:
                    left.append(f"    {name}: {meaning}")
        kept = sign + "\n".join(left) if left else ""
        cls.docstring.value = head + kept + gap + after


def _each_apart(text: str) -> str:
    """Split `frame1, frame2: RGB` into two entries, so that each gets its annotation."""
    head, sign, rest = text.partition("\nArgs:\n")
    if not sign:
        return text
    section, gap, after = rest.partition("\n\n")
    section = _SEVERAL.sub(
        lambda match: "\n".join(f"{match[1]}{name}: {match[3]}" for name in match[2].split(", ")), section
    )
    return head + sign + section + gap + after
