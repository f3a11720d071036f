"""Parse an HTML page or fragment as a browser would."""

from __future__ import annotations

import json
from html.parser import HTMLParser

Attributes = dict[str, str | None]


class Elements(HTMLParser):
    """(tag, attributes) of every element, (attributes, text) of every script, and all other texts of a document."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, Attributes]] = []
        self.scripts: list[tuple[Attributes, str]] = []
        self.texts: list[str] = []
        self._in_script = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        self._in_script = tag == "script"
        if self._in_script:
            self.scripts.append((dict(attrs), ""))

    def handle_endtag(self, tag: str) -> None:
        self._in_script = False

    def handle_data(self, data: str) -> None:
        if self._in_script:
            attributes, text = self.scripts[-1]
            self.scripts[-1] = (attributes, text + data)
        else:
            self.texts.append(data)

    def all(self, tag: str) -> list[Attributes]:
        """The attributes of every element with a given tag."""
        return [attributes for name, attributes in self.found if name == tag]

    def data(self) -> list[dict]:
        """The parsed contents of every script of type application/json."""
        return [json.loads(text) for attributes, text in self.scripts if attributes.get("type") == "application/json"]
