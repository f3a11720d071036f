"""Global motion aggregation: gather motion from pixels with similar context (GMA, Jiang et al. 2021)."""

from __future__ import annotations

from torch import Tensor


def context_attention(query_key: Tensor) -> Tensor:
    """Compute single-head attention between all pairs of pixels from a map of queries and keys."""
    query, key = query_key.flatten(2).chunk(2, dim=1)
    return (query.transpose(1, 2) * query.shape[1] ** -0.5 @ key).softmax(dim=-1)


def gather(attention: Tensor, values: Tensor) -> Tensor:
    """Return the attention-weighted mean of `values` (N, C, H, W) for every pixel, in the same shape."""
    return (values.flatten(2) @ attention.transpose(1, 2)).reshape(values.shape)
