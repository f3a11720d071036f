"""The notebooks of docs/notebooks/ as pages: their text, their code, and their stored outputs."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"


def files() -> dict[str, str | bytes]:
    """The page tutorials/NAME.md of each notebook, and the notebook itself beside it."""
    out: dict[str, str | bytes] = {}
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        out[f"tutorials/{path.stem}.md"] = page(path)
        out[f"tutorials/{path.name}"] = path.read_bytes()
    return out


def page(path: Path) -> str:
    """Convert a notebook to Markdown, with a link to it below its heading."""
    parts = [_cell(cell) for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]]
    heading, _, rest = parts[0].partition("\n")
    return "\n\n".join([heading, f"[The notebook]({path.name}), to run it yourself.", rest.strip(), *parts[1:]]) + "\n"


def _cell(cell: dict[str, Any]) -> str:
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return source
    return "\n\n".join([f"```python\n{source}\n```", *(_output(output) for output in cell["outputs"])])


def _output(output: dict[str, Any]) -> str:
    data = output.get("data", {})
    if "image/png" in data:
        encoded = "".join(data["image/png"]).replace("\n", "")
        return f'<img alt="What the cell above draws" src="data:image/png;base64,{encoded}">'
    if "text/html" in data:
        kept = re.sub(r"<style.*?</style>", "", "".join(data["text/html"]), flags=re.DOTALL)
        # Without this, the keyboard cannot focus and scroll the element.
        reached = 'tabindex="0" role="region" aria-label="Output of the cell above"'
        return f'<div class="output" {reached} markdown="0">' + re.sub(r"\n\s*\n", "\n", kept) + "</div>"
    text = "".join(output.get("text", data.get("text/plain", [])))
    return f'<pre class="output"><code>{html.escape(text.rstrip())}</code></pre>'
