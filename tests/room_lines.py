"""Print the lines of each room beside the guide of the architecture: `python -m tests.room_lines`."""

from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "src" / "robustflow"
GUIDE = {
    "core": 2200,
    "metrics": 1900,
    "media": 800,
    "corruptions": 8000,
    "models": 6800,
    "attacks": 2700,
    "data": 6800,
    "run": 6300,
    "training": 3600,
    "stats": 2700,
    "report": 4500,
    "pictures": 400,
    "paper": 1100,
    "testing": 600,
    "app": 900,
    "cli": 2800,
}
"""Lines with everything, by room (docs/design/architecture.md)."""


def lines_of(folder: Path) -> int:
    """Return the number of lines of the Python files below a folder."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in folder.rglob("*.py"))


def room_lines() -> str:
    """Return a line for each room: its lines, the guide, and the number of files."""
    rows = [(room, lines_of(SOURCE / room), guide, SOURCE / room) for room, guide in GUIDE.items()]
    total = ("all", lines_of(SOURCE), 52_000, SOURCE)
    text = [f"{'room':<12}{'lines':>8}{'guide':>8}{'files':>7}"]
    text += [
        f"{room:<12}{lines:>8}{guide:>8}{len([*at.rglob('*.py')]):>7}" for room, lines, guide, at in [*rows, total]
    ]
    return "\n".join([*text, f"{'tests':<12}{lines_of(SOURCE.parent.parent / 'tests'):>8}{37_000:>8}"])


if __name__ == "__main__":
    print(room_lines())
