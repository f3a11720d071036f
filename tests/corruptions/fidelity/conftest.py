"""Print the maximum deviation for every corruption after the tests."""

from __future__ import annotations


def pytest_terminal_summary(terminalreporter):
    worst: dict[tuple[str, str], tuple[float, str]] = {}
    for outcome in ("passed", "failed"):
        for report in terminalreporter.stats.get(outcome, []):
            for label, found in getattr(report, "user_properties", []):
                if label == "deviation":
                    kind, name, value, where = found
                    worst[kind, name] = max(worst.get((kind, name), (-1.0, "")), (value, where))
    if worst:
        terminalreporter.section("worst deviation from the reference")
    for (kind, name), (value, where) in worst.items():
        terminalreporter.write_line(f"{kind:24} {name:20} {value:8.3f}  {where}")
