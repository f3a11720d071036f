"""Run the code blocks of the documentation as a reader would.

Blocks in `python` and `bash` are run in the order of their page, in a separate folder, unless a comment on the
preceding line says otherwise:

    <!-- not run: WHY -->      the block cannot be run
    <!-- file: NAME -->        the block is the content of a file with that name
    <!-- torch -->             the block needs the extra torch; may be combined with another mark, separated by a comma
"""

import os
import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from robustflow.cli.main import main
from robustflow.media.images import write_image
from tests.data.video import clips

DOCS = Path(__file__).resolve().parent.parent / "docs"
RUNNABLE = ("python", "bash")

_BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>[^\n]*) -->\n)?^```(?P<language>\w*)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL
)
_COMMAND = re.compile(r"^(robustflow|pip|python3?|pytest|torchrun|mkdocs|ray|sbatch|kubectl)\b")


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, its text, and the preceding comment."""

    language: str
    code: str
    mark: str

    @property
    def torch(self) -> bool:
        return "torch" in self.mark.split(", ")

    @property
    def file(self) -> str:
        """The file name if the block is a file; "" otherwise."""
        named = re.search(r"file: (\S+)", self.mark)
        return named[1] if named else ""

    @property
    def why_not(self) -> str:
        """The reason why the block is not run; "" if it is run."""
        reason = re.search(r"not run: (.+)", self.mark)
        return reason[1] if reason else ""

    @property
    def runs(self) -> bool:
        return not self.why_not and (self.language in RUNNABLE or bool(self.file))

    @property
    def hidden_command(self) -> bool:
        """Whether the block contains a command but names no language."""
        return not self.language and bool(_COMMAND.match(self.code))


def blocks(text: str) -> list[Block]:
    """The blocks of a page, in order."""
    return [Block(match["language"], match["code"], match["mark"] or "") for match in _BLOCK.finditer(text)]


def pages() -> list[str]:
    """Every hand-written page, relative to docs/."""
    return sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


class Reader:
    """Runs the blocks of pages in a folder that contains only two frames and a clip, and only the first pair of a
    benchmark that is limited.

    Attributes:
        folder: folder of the frames and the clip.
        runs: folders of the runs, in order of creation.
        printed: output of every command and script, in order.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self.runs, self.printed = folder, [], []
        self._patch, self._capsys = monkeypatch, capsys
        monkeypatch.chdir(folder)
        monkeypatch.syspath_prepend(folder)
        for name in ("frame1.png", "frame2.png"):
            write_image(folder / name, np.full((48, 64, 3), 90, np.uint8))
        clips.clip(folder / "clip.mp4", 4, fps=25)

    def follow(self, page: str, torch: bool = False) -> None:
        """Run the blocks of a page that need PyTorch, or those that do not."""
        text = (DOCS / page).read_text(encoding="utf-8")
        self.run([block for block in blocks(text) if block.torch == torch], page)

    def run(self, listed: list[Block], page: str) -> None:
        names: dict[str, object] = {"__name__": "reader"}
        for block in listed:
            if not block.runs:
                continue
            if block.file:  # all parts together, because Python imports a module only once
                whole = "\n\n".join(part.code for part in listed if part.file == block.file)
                (self.folder / block.file).write_text(whole, encoding="utf-8")
            elif block.language == "python":
                exec(compile(block.code, page, "exec"), names)
                self.printed.append(self._capsys.readouterr().out)
            else:
                for line in block.code.replace("\\\n", " ").splitlines():
                    self._command(shlex.split(line, comments=True))

    def _command(self, words: list[str]) -> None:
        if not words:
            return
        assert words[0] == "robustflow", f"mark the block of '{' '.join(words)}' with <!-- not run: WHY -->"
        if words[1] == "run":
            if not {"--output", "-o"} & set(words):
                words = [*words, "--output", f"run{len(self.runs)}"]
            self.runs.append(words[words.index("--output" if "--output" in words else "-o") + 1])
            words = [*words, "--no-examples"]  # their pictures are tested elsewhere and take seconds
            if "--limit" in words:
                words[words.index("--limit") + 1] = "1"
        self._patch.setattr(sys, "argv", words)
        with patch.dict(os.environ), pytest.raises(SystemExit) as stop:
            main()
        captured = self._capsys.readouterr()
        assert stop.value.code in (0, None), f"{' '.join(words)}: {captured.err}"
        self.printed.append(captured.out)
