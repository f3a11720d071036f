"""Global motion aggregation: motion gathered from pixels with similar context (GMA, Jiang et al. 2021)."""

from __future__ import annotations

from torch import Tensor


def context_attention(query_key: Tensor) -> Tensor:
    """Attention of every pixel to every pixel, from a map of queries and keys, with one head.

    Args:
        query_key: (N, 2 * C, H, W): C channels of queries, then C of keys.

    Returns:
        (N, H * W, H * W): row `i` holds the weights of all pixels for pixel `i`.
    """
    query, key = query_key.flatten(2).chunk(2, dim=1)
    return (query.transpose(1, 2) * query.shape[1] ** -0.5 @ key).softmax(dim=-1)


def gather(attention: Tensor, values: Tensor) -> Tensor:
    """The attention-weighted mean of `values` (N, C, H, W) for every pixel; the same shape.

    >>> import torch
    >>> features = torch.rand(1, 8, 4, 6)
    >>> gather(torch.eye(24)[None], features).equal(features)
    True
    """
    return (values.flatten(2) @ attention.transpose(1, 2)).reshape(values.shape)
