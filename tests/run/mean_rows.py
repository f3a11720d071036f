"""Rows with given mean errors."""

COUNTS = ("fl_count", "px1_count", "px3_count", "px5_count")
NO_TRUTH = dict.fromkeys(("n_valid", "n_truth", "epe_sum", "clean_epe_sum", "rcre_sum", "wauc_sum", *COUNTS))
"""What a row without ground truth lacks."""


def row(sample, corruption="clean", severity=0, n=10, epe=0.0, rcre=0.0, **columns):
    """A row with mean errors `epe` and `rcre` over `n` valid pixels out of 2 `n`."""
    filled = {
        "sample": sample,
        "group": sample,
        "corruption": corruption,
        "severity": severity,
        "height": 2,
        "width": n,
        "n_invalid": 0,
        "n_all": 2 * n,
        "rcre_all_sum": 3 * rcre * n,
        "pred_magnitude_sum": 0.0,
        "n_valid": n,
        "epe_sum": epe * n,
        "rcre_sum": rcre * n,
        "magnitude_sum": 0.0,
        "wauc_sum": 0.0,
    }
    return filled | dict.fromkeys(COUNTS, 0) | columns


THREE_IMAGES = [
    row("a", n=10, epe=1.0),
    row("b", n=30, epe=3.0),
    row("c", n=20, epe=8.0),
    row("a", "fog", 1, n=10, epe=2.0, rcre=4.0),
    row("b", "fog", 1, n=30, epe=5.0, rcre=8.0),
    row("c", "fog", 1, n=20, epe=14.0, rcre=3.0),
    row("a", "fog", 2, n=10, epe=4.0, rcre=6.0),
    row("b", "fog", 2, n=30, epe=9.0, rcre=10.0),
    row("c", "fog", 2, n=20, epe=20.0, rcre=5.0),
    row("a", "snow", 1, n=10, epe=0.0, rcre=1.0),
    row("b", "snow", 1, n=30, epe=2.0, rcre=1.0),
    row("c", "snow", 1, n=20, epe=1.0, rcre=4.0),
]
"""Rows whose means differ from their medians, and from their means over pixels."""
