"""State of a training run: network, its moving average, optimiser, step, curve; checkpoints that resume exactly."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader, Dataset

from correlograph.errors import InputError
from correlograph.files.output import save_json
from correlograph.lags import OBJECT_SIDE
from correlograph.workers import one_torch_thread
from invert.network.checkpoints import NETWORKS, load_network, read_weights, save_weights
from invert.network.despeckler import Despeckler
from invert.network.model import CorrelographyNet, Fusion
from invert.network.sampler import Sampler
from invert.training.data import Batch, at_noise, hidden_in_noise, make_varied_batch, paper_noise, warm
from invert.training.objectives import objective
from invert.training.report import save_curve
from invert.training.speckle import LEVELS, SIDE, Speckled, draw_speckled, speckled_at
from invert.training.warm_starts import load_warm_starts, split_warm_starts

VALIDATION = ((80 / 255, 256.0), (80 / 255, 64.0), (80 / 255, 16.0), (5 / 255, 1e4), (1.5, 64.0))
"""Pairs of floor (in units of the highest estimate except at zero lag) and K at which progress is measured."""

VALIDATION_IMAGES = 64
"""Number of held-out targets per level; fewer of larger targets."""

WARM_UP = 200
"""Steps over which the learning rate rises linearly."""


class Training:
    """State of a run: network, its moving average, optimiser, step, curve.

    One part of the default network is trained; the others remain fixed. `rank` of `world` processes works on its fraction of each
    batch.
    """

    def __init__(self, options: Any, rank: int = 0, world: int = 1) -> None:
        self.options, self.rank, self.world = options, rank, world
        torch.manual_seed(options.seed)
        self.network = NETWORKS[options.network](options.width).to(device=options.device, memory_format=torch.channels_last)
        if isinstance(self.network, CorrelographyNet):
            self.network.requires_grad_(False)
        self.part = self._part_of(self.network).requires_grad_(True)
        self.trained = list(self.part.parameters())
        self.objective = objective(self.part, options.loss)
        module = self._answering(self.network)
        self.parallel = nn.parallel.DistributedDataParallel(module) if world > 1 else module
        self.average = AveragedModel(self.network, multi_avg_fn=_follow, use_buffers=True)
        self.optimiser = torch.optim.AdamW(self.trained, options.learning_rate, (0.9, 0.99), weight_decay=0.01)
        self.step, self.curve = 0, []
        self.earlier: dict[str, Any] | None = None
        self.warm, self.warm_held_out = split_warm_starts(load_warm_starts(options.warm)) if options.warm else (None, None)
        if options.start_from:
            self.start_from(options.start_from)
        self.seconds = self.cpu_seconds = 0.0

    def batches(self, targets: Sequence[torch.Tensor]) -> Iterator[Batch | Speckled]:
        """Draw the batches of the steps left, in worker processes if there are any; steps alternate between the target pools."""
        steps, workers = range(self.step, self.options.steps), self.options.workers
        loader = DataLoader(
            _Batches(self, targets),
            batch_size=None,
            sampler=steps,
            num_workers=workers,
            multiprocessing_context="fork" if workers else None,  # forked processes share the targets
        )
        batches = iter(loader)
        for _ in steps:
            with self._count_time():
                batch = next(batches)
            yield batch

    def advance(self, batch: Batch | Speckled) -> float:
        """Take one optimiser step; return the loss."""
        with self._count_time():
            return self._advance(batch.part(slice(self.rank, None, self.world), self.options.device))

    def _advance(self, batch: Batch | Speckled) -> float:
        options = self.options
        for group in self.optimiser.param_groups:
            group["lr"] = options.learning_rate * _schedule(self.step, options.steps)
        self.parallel.train()
        loss = self.objective.loss(self.parallel, batch, _rng(options.seed + 1 + self.rank, self.step))
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.trained, 1.0)
        self.optimiser.step()
        self.average.update_parameters(self.network)
        self.step += 1
        return float(loss.detach())

    @contextmanager
    def _count_time(self) -> Iterator[None]:
        """Add the time within to that of the run; the CPU time is that of this process, without its workers."""
        begin, begin_cpu = time.perf_counter(), time.process_time()
        yield
        self.seconds += time.perf_counter() - begin
        self.cpu_seconds += time.process_time() - begin_cpu

    @property
    def _despeckles(self) -> bool:
        return isinstance(self.part, Despeckler)

    def _part_of(self, network: nn.Module) -> nn.Module:
        """Return the trained part of a network."""
        return getattr(network, self.options.part) if isinstance(network, CorrelographyNet) else network

    def _answering(self, network: nn.Module) -> nn.Module:
        """Return the module to run: the trained part, or the whole network for the fusion."""
        part = self._part_of(network)
        return network if isinstance(part, Fusion) else part

    def draw(self, targets: torch.Tensor, step: int) -> Batch | Speckled:
        """Return the batch of a step; larger targets make smaller batches of as many pixels."""
        if self._despeckles:
            device, count = self.options.device, max(2, self.options.batch * OBJECT_SIDE**2 // SIDE**2)
            with torch.device(device):
                return draw_speckled(targets, count, _rng(self.options.seed, step, device))
        rng = _rng(self.options.seed, step)
        count = max(2, self.options.batch * OBJECT_SIDE**2 // targets.shape[-1] ** 2)
        if self.options.noise == "paper":
            return paper_noise(targets, count, rng)
        return self._make_batch_for_part(
            make_varied_batch(targets, count, rng) if self.warm is None else warm(self.warm, count, rng), rng
        )

    def _make_batch_for_part(self, batch: Batch, rng: torch.Generator) -> Batch:
        return hidden_in_noise(batch, rng) if isinstance(self.part, Sampler) else batch

    def place(self, targets: Sequence[torch.Tensor]) -> list[torch.Tensor]:
        """Return the target pools where batches are drawn from them."""
        return [pool.to(self.options.device) if self._despeckles else pool for pool in targets]

    def validation(self, held_out: Sequence[torch.Tensor]) -> Sequence[Batch | Speckled]:
        """Return held-out targets at the levels of `VALIDATION` or, for the despeckler, `LEVELS`; or held-out precomputed
        reconstructions at noise of every level."""
        rng = torch.Generator().manual_seed(self.options.seed)
        if self._despeckles:  # drawn where all trainings draw them alike
            return [speckled_at(pool, VALIDATION_IMAGES, *level, rng) for pool in held_out for level in LEVELS]
        if self.warm_held_out is not None:
            return [warm(self.warm_held_out, 256, rng)]
        batches = []
        for pool in held_out:
            count = VALIDATION_IMAGES * OBJECT_SIDE**2 // pool.shape[-1] ** 2
            chosen = pool[torch.randperm(len(pool), generator=rng)[:count]].float() / 255.0
            batches += [self._make_batch_for_part(at_noise(chosen, floor, dof, rng), rng) for floor, dof in VALIDATION]
        return batches

    def note(self, loss: float, validation: Sequence[Batch | Speckled]) -> None:
        """Measure the averaged network and add a point to the curve."""
        averaged = self._answering(self.average.module).eval()
        with torch.no_grad():
            measured = [
                self.objective.measure_progress(averaged, batch.part(slice(None), self.options.device)) for batch in validation
            ]
        self.curve.append(
            {"step": self.step, "seconds": self.seconds, "cpu_seconds": self.cpu_seconds, "loss": loss, "validation": measured}
        )

    def last_line(self) -> str:
        point = self.curve[-1]
        figures = ", ".join(f"{value:.3f} ({label})" for label, value in zip(self._labels, point["validation"], strict=True))
        return f"step {point['step']}, {point['seconds']:.0f} s: loss {point['loss']:.3f}; {self.objective.measure}: {figures}"

    @property
    def _labels(self) -> list[str]:
        """Names of the noise levels at which progress is measured, per dataset."""
        if self.options.warm:
            return ["warm starts, every level"]
        several = len(self.options.dataset) > 1
        levels = (
            [f"{looks} looks, {photons:g} photons" for looks, photons in LEVELS]
            if self._despeckles
            else [f"floor {255 * floor:.0f}/255, K {dof:g}" for floor, dof in VALIDATION]
        )
        return [f"{name}: {level}" if several else level for name in self.options.dataset for level in levels]

    @property
    def _checkpoint_path(self) -> Path:
        return self.options.output.with_suffix(".checkpoint.safetensors")

    def checkpoint(self) -> None:
        """Write the complete state to one file."""
        tensors = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"average.{name}": value for name, value in self.average.module.state_dict().items()}
        for index, state in self.optimiser.state_dict()["state"].items():
            tensors |= {f"optimiser.{index}.{name}": torch.as_tensor(value) for name, value in state.items()}
        tensors |= {f"objective.{name}": value for name, value in self.objective.state.items()}
        save_weights(
            self._checkpoint_path,
            tensors,
            {
                "run": self._run(),
                "step": self.step,
                "seconds": self.seconds,
                "cpu_seconds": self.cpu_seconds,
                "curve": self.curve,
            },
        )

    def resume(self) -> None:
        """Resume from a checkpoint next to the weights, if there is one of the same run."""
        if not self._checkpoint_path.is_file():
            return
        tensors, card = read_weights(self._checkpoint_path)
        if card.get("run") != self._run():
            raise InputError(
                "checkpoint",
                f"one of the run {self._run()}",
                f"{card.get('run')} in {self._checkpoint_path}",
                "delete it or write to another name",
            )
        parts: dict[str, dict[str, torch.Tensor]] = {"network": {}, "average": {}, "optimiser": {}, "objective": {}}
        for name, value in tensors.items():
            kind, _, rest = name.partition(".")
            parts[kind][rest] = value
        self.network.load_state_dict(parts["network"])
        self.average.module.load_state_dict(parts["average"])
        self.average.n_averaged.fill_(card["step"])
        self.objective.restore(parts["objective"])
        states: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in parts["optimiser"].items():
            index, _, rest = name.partition(".")
            states.setdefault(int(index), {})[rest] = value
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": states})
        self.step, self.curve = card["step"], card["curve"]
        self.seconds, self.cpu_seconds = card["seconds"], card["cpu_seconds"]

    def start_from(self, path: Path) -> None:
        """Start with the weights of an earlier run of the same kind of network."""
        earlier, self.earlier = load_network(path, kinds=tuple(NETWORKS))
        if self.earlier["network"] != self.options.network or self.earlier["width"] != self.options.width:
            raise InputError(
                "--start-from",
                f"a {self.options.network} of width {self.options.width}",
                f"a {self.earlier['network']} of width {self.earlier['width']}",
                "use weights of this kind",
            )
        self.network.load_state_dict(earlier.state_dict())
        self.average.module.load_state_dict(earlier.state_dict())

    def _run(self) -> dict[str, Any]:
        names = (
            "dataset",
            "network",
            "width",
            "loss",
            "noise",
            "steps",
            "batch",
            "learning_rate",
            "seed",
            "part",
            "warm",
            "device",
        )
        return {**{name: getattr(self.options, name) for name in names}, "start_from": self.earlier}

    def finish(self, dataset: list[dict[str, Any]]) -> None:
        """Write the averaged weights in half precision with their metadata, and the curve."""
        averaged = self.average.module.state_dict()
        half = {name: value.half() if value.is_floating_point() else value for name, value in averaged.items()}
        card = {
            "network": self.options.network,
            "width": self.options.width,
            "run": self._run(),
            "seconds": round(self.seconds),
            "cpu_seconds": round(self.cpu_seconds),
            "dataset": dataset,
            "levels": self._labels,
            "measure": self.objective.measure,
            "validation": self.curve[-1]["validation"],
            "torch": torch.__version__,
            "threads": torch.get_num_threads(),
        }
        save_weights(self.options.output, half, card)
        save_curve(self.options.output.with_suffix(".png"), self.curve, self.objective.measure, self._labels)
        save_json(self.options.output.with_suffix(".json"), {**card, "curve": self.curve})


class _Batches(Dataset):
    """The batch of every step, by its number; drawn by one thread, because the last bits depend on the number of threads."""

    def __init__(self, training: Training, targets: Sequence[torch.Tensor]) -> None:
        self._training, self._targets = training, targets

    def __getitem__(self, step: int) -> Batch | Speckled:
        with one_torch_thread():
            return self._training.draw(self._targets[step % len(self._targets)], step)


def _follow(average: Sequence[torch.Tensor], current: Sequence[torch.Tensor], updates: torch.Tensor | int) -> None:
    """Move exponential moving averages, which follow closely at first; batch counters are copied."""
    if average[0].is_floating_point():
        torch._foreach_lerp_(average, current, max(1e-3, 9.0 / (10.0 + float(updates))))
    else:
        torch._foreach_copy_(average, current)


def _schedule(step: int, steps: int) -> float:
    """Return the learning rate factor: warm-up, then a half cosine down to a hundredth."""
    return min(1.0, (step + 1) / WARM_UP) * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * step / steps)))


def _rng(seed: int, step: int, device: str = "cpu") -> torch.Generator:
    return torch.Generator(device).manual_seed((seed << 32) + step)
