"""Networks as users write them: with frozen layers, several outputs or a loss of their own, and with mistakes."""

import torch
from torch import nn


class Plain(nn.Module):
    def __init__(self):
        super().__init__()
        self.last = nn.Conv2d(6, 2, 3, padding=1)

    def forward(self, image1, image2):
        return self.last(torch.cat([image1, image2], dim=1))


class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.corrector = nn.Conv2d(6, 8, 3, padding=1)  # also the prefix of BrightFlow's corrector
        self.norm = nn.BatchNorm2d(8)
        self.last = nn.Conv2d(8, 2, 3, padding=1)

    def forward(self, image1, image2):
        flow = self.last(self.norm(self.corrector(torch.cat([image1, image2], dim=1))))
        return [flow / 2, flow]


RETURNED = {
    "list in a dictionary": lambda there, back: {"back": back, "flows": [there / 2, there]},
    "dictionary": lambda there, back: {"flow": there, "back": back},
    "pair": lambda there, back: (there, back),
    "list in a tuple": lambda there, back: ([there / 2, there], there[:, :1]),
    "tuple": lambda there, back: (there / 2, there),
}


class Several(Plain):
    def __init__(self, returned="pair"):
        super().__init__()
        self.returned = RETURNED[returned]

    def forward(self, image1, image2):
        return self.returned(super().forward(image1, image2), super().forward(image2, image1))


class Frozen(nn.Module):
    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(3, 8, 3, padding=1).requires_grad_(False)
        self.norm = nn.BatchNorm2d(8)
        self.last = nn.Conv2d(16, 2, 3, padding=1)

    def forward(self, image1, image2):
        features = self.norm(self.first(torch.cat([image1, image2])))
        return self.last(torch.cat(features.chunk(2), dim=1))


class Norms(nn.Module):
    def __init__(self):
        super().__init__()
        self.norms = nn.ModuleList(kind(2) for kind in (nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm))

    def forward(self, image1, image2):
        return (image1 - image2)[:, :2]


def with_loss(returned):
    """A network whose loss returns what `returned` makes of the error."""

    class Net(Plain):
        def loss(self, batch):
            assert set(batch) == {"image1", "image2", "flow", "valid"}
            assert -1 <= batch["image1"].min() <= batch["image1"].max() <= 1
            flow = self(batch["image1"], batch["image2"])
            return returned((flow - batch["flow"]).square().sum(1)[batch["valid"] > 0].mean())

    return Net


WithLoss = with_loss(lambda error: (error, {"squared": error, "update": 7, "empty": float("nan")}))
LossInAList = with_loss(lambda error: [error])
Text = with_loss(lambda error: (error, {"remark": "fine"}))
Complex = with_loss(lambda error: (error, {"spectrum": 1j}))


class NoEntry(Plain):
    def loss(self, batch):
        return batch["disparity"]


class NanInEvaluation(Plain):
    def forward(self, image1, image2):
        return super().forward(image1, image2) * (1 if self.training else float("nan"))


class Cut(Plain):
    def forward(self, image1, image2):
        return super().forward(image1, image2).detach()


class Full(Plain):
    def forward(self, image1, image2):
        if self.training:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return super().forward(image1, image2)


class Epoch(Plain):
    def get_extra_state(self):
        return {"epoch": 3}

    def set_extra_state(self, state):
        pass
