"""What happens around every epoch: seeds, learning rates, and a state that is kept."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import torch
from lightning.pytorch import Callback

from eitbench.methods.training.checkpoint import Checkpoint
from eitbench.methods.training.curve import Epoch, best, write_log
from eitbench.methods.training.trainee import Trainee
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.seeds import generator

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lightning.pytorch import LightningModule, Trainer
    from torch import Tensor

    from eitbench.methods.training.progress import EpochProgress
    from eitbench.methods.training.recipe import Recipe


class DivergedError(EitbenchError):
    """A loss is not finite; the state after the last good epoch is kept."""


class Keeper(Callback):
    """Sets seeds and learning rates, and keeps the state after every epoch."""

    def __init__(
        self,
        recipe: Recipe,
        folder: Path,
        settings: Mapping[str, object],
        begun: Checkpoint | None,
        bar: EpochProgress,
    ) -> None:
        self.recipe, self.folder, self.settings, self.bar = recipe, folder, settings, bar
        self.begun = begun
        self.curve = () if begun is None else begun.curve
        self.best: Mapping[str, Tensor] = {} if begun is None else begun.best
        bar.moved(len(self.curve))

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Restore the optimiser of the training that is continued."""
        if self.begun is not None:
            _restore(trainer.optimizers[0], self.begun.optimizer)

    def on_train_epoch_start(self, trainer: Trainer, module: LightningModule) -> None:
        """Seed all that is drawn in this epoch."""
        rng = generator("training epoch", self.recipe.seed, len(self.curve))
        seeds = rng.integers(2**63, size=trainer.world_size)  # each device draws its own
        torch.manual_seed(int(seeds[trainer.global_rank]))
        self.started = time.perf_counter()
        assert isinstance(module, Trainee)
        module.epochs_done = len(self.curve)

    def on_train_batch_start(
        self, trainer: Trainer, module: LightningModule, batch: Any, index: int
    ) -> None:
        """Set the learning rate."""
        done = len(self.curve) + index / trainer.num_training_batches
        self.rate = self.recipe.rate_at(done / self.recipe.epochs)
        for group in trainer.optimizers[0].param_groups:
            group["lr"] = self.rate
        self.bar.moved(done)

    def on_train_batch_end(
        self, trainer: Trainer, module: LightningModule, outputs: Any, batch: Any, index: int
    ) -> None:
        """Stop where the loss is not finite."""
        if trainer.strategy.root_device.type == "cpu":  # elsewhere, asking would make it wait
            self._check(float(outputs["loss"]))

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        """Add a line to the curve and replace the checkpoint."""
        assert isinstance(module, Trainee)
        losses = {name: float(value) for name, value in trainer.callback_metrics.items()}
        self._check(*losses.values())
        epoch = Epoch(
            epoch=len(self.curve) + 1,
            train=losses.pop("train"),
            validation=losses.pop("validation"),
            rate=self.rate,
            seconds=time.perf_counter() - self.started,
            others=losses,
        )
        self.curve = (*self.curve, epoch)
        weights = module.network.state_dict()
        if best(self.curve) is epoch:
            self.best = {name: tensor.clone() for name, tensor in weights.items()}
        state = _state(trainer.optimizers[0])
        if trainer.is_global_zero:
            Checkpoint(weights, self.best, state, self.curve).write(self.folder, self.settings)
            write_log(self.folder, self.curve)
        self.bar.finished(epoch)
        trainer.should_stop = self.recipe.over_after(self.curve)

    def _check(self, *losses: float) -> None:
        if not all(map(math.isfinite, losses)):
            done = len(self.curve)
            kept = f"its state after epoch {done} is kept" if done else "nothing was kept"
            raise DivergedError(
                f"The training in {self.folder} diverged: a loss in epoch {done + 1} is not "
                f"finite; {kept}."
            )


def _state(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    state = optimizer.state_dict()["state"]
    return {f"{k}.{name}": value for k, named in state.items() for name, value in named.items()}


def _restore(optimizer: torch.optim.Optimizer, named: Mapping[str, Tensor]) -> None:
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in named.items():
        number, name = key.split(".", 1)
        state.setdefault(int(number), {})[name] = value
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
