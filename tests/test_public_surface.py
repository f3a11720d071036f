"""No public name, parameter, command or option disappears unnoticed, because users' scripts refer to them."""

from importlib.util import find_spec
from pathlib import Path

from .public_surface import surface

KNOWN = Path(__file__).with_name("public_surface.txt").read_text(encoding="utf-8").splitlines()
TORCH = find_spec("torch") is not None
"""Without PyTorch there is no `TorchModel`."""


def test_nothing_disappears():
    known = {line for line in KNOWN if TORCH or not line.startswith("robustflow.TorchModel")}
    assert not sorted(known - set(surface())), "gone, or changed: these lines of tests/public_surface.txt"


def test_what_is_new_is_written_down():
    new = sorted(set(surface()) - set(KNOWN))
    assert not new, "python -m tests.public_surface > tests/public_surface.txt"
