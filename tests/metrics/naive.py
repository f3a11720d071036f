"""The metrics implemented as plain Python loops in float64, directly from their definitions."""

import math


def distance(a, b):
    """|a - b| of two vectors (u, v), or None if one is not finite."""
    numbers = [float(value) for value in (*a, *b)]
    if not all(math.isfinite(value) for value in numbers):
        return None
    du, dv = numbers[0] - numbers[2], numbers[1] - numbers[3]
    return math.sqrt(du * du + dv * dv)


def pixels(array):
    """Coordinates (y, x) of every pixel, in row-major order."""
    return [(y, x) for y in range(array.shape[0]) for x in range(array.shape[1])]


def wauc(error):
    """Weighted area under the inlier curve of one pixel, summed over all 100 thresholds."""
    weights = [1 - (i - 1) / 100 for i in range(1, 101)]
    return sum(w for i, w in enumerate(weights, 1) if error <= i / 20) / sum(weights)


def is_fl(error, truth):
    return error > 3 and error > 0.05 * distance(truth, (0, 0))


def edges(flow, valid):
    """Motion edges, found by comparing every pixel with the next valid one to its right and below."""
    found = set()
    for y, x in pixels(valid):
        if not valid[y, x]:
            continue
        for dy, dx in ((0, 1), (1, 0)):
            for gap in range(1, 6):
                other = (y + gap * dy, x + gap * dx)
                if other[0] >= valid.shape[0] or other[1] >= valid.shape[1]:
                    break
                if not valid[other]:
                    continue
                longer = max(distance(flow[y, x], (0, 0)), distance(flow[other], (0, 0)))
                if distance(flow[y, x], flow[other]) > gap * max(1, 0.05 * longer):
                    found |= {(y, x), other}
                break
    return found


def edge_distance(y, x, found):
    return min((math.sqrt((y - a) ** 2 + (x - b) ** 2) for a, b in found), default=math.inf)


def regions_of(y, x, flow, occluded, found):
    """Names of the regions that contain a valid pixel."""
    length = distance(flow[y, x], (0, 0))
    away = edge_distance(y, x, found)
    names = {"s0_10" if length < 10 else "s10_40" if length < 40 else "s40"}
    names |= {"d0_10" if away < 10 else "d10_60" if away < 60 else "d60"}
    if occluded is not None:
        names |= {"occ" if occluded[y, x] else "noc"}
    return names


def photometric(frame1, frame2, flow):
    """The photometric error and that of zero flow, in grey levels; every step is exact in float64."""
    grey1, grey2 = (frame.astype(float).sum(axis=2) for frame in (frame1, frame2))
    (height, width), n, total, still = grey1.shape, 0, 0.0, 0.0
    for y, x in pixels(grey1):
        to_x, to_y = x + float(flow[y, x, 0]), y + float(flow[y, x, 1])
        if not (0 <= to_x <= width - 1 and 0 <= to_y <= height - 1):
            continue
        to_x, to_y = math.floor(256 * to_x + 0.5) / 256, math.floor(256 * to_y + 0.5) / 256
        value = 0.0
        for corner_y in (math.floor(to_y), math.ceil(to_y)):
            for corner_x in (math.floor(to_x), math.ceil(to_x)):
                weight_y = 1 - abs(corner_y - to_y) if to_y % 1 else 0.5
                weight_x = 1 - abs(corner_x - to_x) if to_x % 1 else 0.5
                value += weight_y * weight_x * grey2[corner_y, corner_x]
        n += 1
        total += abs(grey1[y, x] - value)
        still += abs(grey1[y, x] - grey2[y, x])
    return {"n_photometric": n, "photometric_sum": total / 3, "photometric_still_sum": still / 3}


def row(pred, clean, flow, valid, occluded):
    """All sums and counts of a row, accumulated in row-major order; None for regions that do not exist."""
    columns = ("n_valid", "fl_count", "px1_count", "px3_count", "px5_count", "n_all", "n_invalid")
    out = dict.fromkeys(columns, 0)
    out |= dict.fromkeys(
        ("epe_sum", "rcre_sum", "magnitude_sum", "rcre_all_sum", "pred_magnitude_sum", "wauc_sum"), 0.0
    )
    names = ["s0_10", "s10_40", "s40", "d0_10", "d10_60", "d60"]
    if occluded is not None:
        names += ["occ", "noc"]
    for name in names:
        out |= {f"n_{name}": 0, f"epe_sum_{name}": 0.0, f"rcre_sum_{name}": 0.0, f"fl_count_{name}": 0}
    out |= {name.replace("epe", "clean_epe"): 0.0 for name in out if name.startswith("epe_sum")} | {"n_truth": 0}
    found = edges(flow, valid)
    for y, x in pixels(valid):
        out["n_truth"] += bool(valid[y, x])
        out["n_invalid"] += distance(pred[y, x], (0, 0)) is None
        moved = distance(pred[y, x], clean[y, x])
        if moved is None:
            continue
        out["n_all"] += 1
        out["rcre_all_sum"] += moved
        out["pred_magnitude_sum"] += distance(pred[y, x], (0, 0))
        if not valid[y, x]:
            continue
        error = distance(pred[y, x], flow[y, x])
        out["n_valid"] += 1
        out["epe_sum"] += error
        before = distance(clean[y, x], flow[y, x])
        out["clean_epe_sum"] += before
        out["rcre_sum"] += moved
        out["magnitude_sum"] += distance(flow[y, x], (0, 0))
        out["fl_count"] += is_fl(error, flow[y, x])
        for threshold in (1, 3, 5):
            out[f"px{threshold}_count"] += error > threshold
        out["wauc_sum"] += wauc(error)
        for name in regions_of(y, x, flow, occluded, found):
            out[f"n_{name}"] += 1
            out[f"epe_sum_{name}"] += error
            out[f"clean_epe_sum_{name}"] += before
            out[f"rcre_sum_{name}"] += moved
            out[f"fl_count_{name}"] += is_fl(error, flow[y, x])
    return out
