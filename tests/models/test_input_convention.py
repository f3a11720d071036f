"""Frames are padded to the next size that a network accepts."""

import pytest

from robustflow.models.conventions import InputConvention


@pytest.mark.parametrize("vertical", ["both", "bottom"])
@pytest.mark.parametrize("multiple", [1, 8, 16, 32])
def test_padding_is_up_to_the_next_multiple(vertical, multiple):
    convention = InputConvention(fit="pad", multiple=multiple, vertical=vertical)
    for height in range(1, 70, 3):
        for width in range(1, 70, 4):
            left, right, above, below = convention.padding_sides(height, width)
            fitted = convention.fitted_size(height, width)
            assert fitted == (height + above + below, width + left + right)
            for fit, own in ((fitted[0], height), (fitted[1], width)):
                assert fit % multiple == 0
                assert 0 <= fit - own < multiple
            assert right - left in (0, 1)
            assert (above == 0) if vertical == "bottom" else (below - above in (0, 1))
