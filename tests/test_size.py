"""Test the parsing of sizes given as HEIGHTxWIDTH."""

import pytest

from robustflow.core.errors import UsageError
from robustflow.core.types import parse_size


@pytest.mark.parametrize(
    "text",
    [
        "",
        "256",
        "256x",
        "x832",
        "256x832x3",
        "-256x832",
        "256 x832",
        "2e2x832",
        "64x100000",
        "²x64",
        "9" * 5000 + "x64",
    ],
    ids=lambda text: text[:12],
)
def test_text_that_is_not_a_size_is_refused(text):
    with pytest.raises(UsageError, match="is not a size: write HEIGHTxWIDTH") as error:
        parse_size(text, 64)
    assert len(str(error.value)) < 120


@pytest.mark.parametrize("text", ["0x0", "0x64", "100x832", "256x830"])
def test_sizes_that_are_no_multiples_are_refused(text):
    with pytest.raises(UsageError, match=f"size {text}: height and width must be multiples of 64"):
        parse_size(text, 64)


@pytest.mark.parametrize("text", ["15x64", "64x15", "4097x64", "64x4097"])
def test_sizes_out_of_range_are_refused(text):
    with pytest.raises(UsageError, match="must be 16 to 4096 pixels"):
        parse_size(text, smallest=16, largest=4096)
    assert parse_size(text) == tuple(int(side) for side in text.split("x"))
    assert parse_size("16x4096", smallest=16, largest=4096) == (16, 4096)
