"""An Adam that keeps its own learning rate under SB3's common schedule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch as th


class ScaledAdam(th.optim.Adam):
    """Adam whose steps use `lr_ratio` times the learning rate in its parameter groups.

    SB3 writes one scheduled learning rate into all optimizers before each `train()`; the ratio lets the critic learn
    faster than the actor while both follow that schedule. It is saved in the parameter groups. Adam is fused, which
    is several times faster on a CPU.

    Args:
        params: As in `torch.optim.Adam`.
        lr: As in `torch.optim.Adam`; SB3 overwrites it.
        lr_ratio: The step's learning rate divided by `lr`.
        kwargs: Passed on to `torch.optim.Adam`.
    """

    def __init__(self, params: Any, lr: float = 1e-3, lr_ratio: float = 1.0, **kwargs: Any) -> None:
        super().__init__(params, lr=lr, **{"fused": True, **kwargs})
        self.defaults["lr_ratio"] = lr_ratio
        for group in self.param_groups:
            group.setdefault("lr_ratio", lr_ratio)

    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """Take one Adam step at `lr * lr_ratio`."""
        scheduled = [group["lr"] for group in self.param_groups]
        try:
            for group in self.param_groups:
                group["lr"] = group["lr"] * group["lr_ratio"]
            loss: float | None = super().step(closure)
            return loss
        finally:
            for group, lr in zip(self.param_groups, scheduled):
                group["lr"] = lr
