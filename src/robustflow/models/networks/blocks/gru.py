"""A separable convolutional GRU with 1 x 5 and 5 x 1 kernels (RAFT, Teed and Deng 2020, section 3.3)."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class SepConvGRU(nn.Module):
    """A layer of two GRU steps, along rows and then along columns."""

    def __init__(self, hidden: int = 128, inputs: int = 256) -> None:
        super().__init__()
        for step, kernel, padding in ((1, (1, 5), (0, 2)), (2, (5, 1), (2, 0))):
            for gate in "zrq":
                self.add_module(
                    f"conv{gate}{step}", nn.Conv2d(hidden + inputs, hidden, kernel_size=kernel, padding=padding)
                )

    def forward(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Return the new state (N, hidden, H, W) from the state (N, hidden, H, W) and the input (N, inputs, H, W)."""
        for convz, convr, convq in (
            (self.convz1, self.convr1, self.convq1),
            (self.convz2, self.convr2, self.convq2),
        ):
            both = torch.cat((state, inputs), dim=1)
            update = torch.sigmoid(convz(both))
            reset = torch.sigmoid(convr(both))
            candidate = torch.tanh(convq(torch.cat((reset * state, inputs), dim=1)))
            state = (1 - update) * state + update * candidate
        return state
