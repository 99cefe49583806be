"""`python -m invert.warm_starts TARGETS.zarr --weights DENOISER.safetensors -o WARM.zarr`: what the fusion is trained with.

Noisy estimates, denoised, with what classical retrieval makes of each. Goes on where it was stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import zarr

from invert.network.features import PICTURES
from radiometry.autocorrelation import LAG_SIDE
from radiometry.errors import ArgumentParser, InputError, check_seed

if TYPE_CHECKING:
    from invert.network.model import CorrelographyNet

CHUNK = 32
ARRAYS = {"albedo": ((64, 64), "uint8"), "classical": ((PICTURES, 64, 64), "uint8"),
          "estimate": ((LAG_SIDE, LAG_SIDE), "float16"), "denoised": ((LAG_SIDE, LAG_SIDE), "float16"),
          "floor": ((), "float32"), "dof": ((), "float32")}

QUALITY = "fast"
"""Quality of the classical retrieval: the least that the network will be shown."""


def main(argv: Sequence[str] | None = None) -> None:
    parser = ArgumentParser(prog="python -m invert.warm_starts", description="Classical reconstructions to train with.")
    parser.add_argument("targets", help="dataset made by python -m data_gen")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--weights", required=True, type=Path, help="a trained denoiser, .safetensors")
    parser.add_argument("--count", type=int, default=12800)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    check_seed(options.seed)
    if options.count < CHUNK or options.count % CHUNK:
        raise InputError("--count", f"a multiple of {CHUNK}", options.count, "choose another")
    from tqdm import tqdm

    from data_gen.dataset import load_targets
    from invert.network.checkpoints import load_network
    from invert.network.model import CorrelographyNet

    network, card = load_network(options.weights)
    if not isinstance(network, CorrelographyNet):
        raise InputError("--weights", "a network with a denoiser", f"the kind {card['network']}", "train --network unet")
    group = _open(options.output, {"targets": options.targets, "seed": options.seed, "count": options.count,
                                   "denoiser": card["run"]})
    targets, _ = load_targets(options.targets)
    for chunk in tqdm(range(options.count // CHUNK), unit="chunk", disable=None):
        if not group["complete"][chunk]:
            for name, values in _chunk(network, targets, options.seed, chunk).items():
                group[name][chunk * CHUNK : (chunk + 1) * CHUNK] = values
            group["complete"][chunk] = 1


def _open(address: str, recipe: dict[str, Any]) -> zarr.Group:
    group = zarr.open_group(address, mode="a")
    if group.attrs.asdict() not in ({}, recipe):
        raise InputError("-o", f"a store begun with {recipe}", group.attrs.asdict(), "choose another address")
    count = recipe["count"]
    for name, (shape, kind) in ARRAYS.items():
        group.require_array(name, shape=(count, *shape), dtype=kind, chunks=(CHUNK, *shape))
    group.require_array("complete", shape=(count // CHUNK,), dtype="uint8", chunks=(1,))
    group.attrs.update(recipe)
    return group


def _chunk(network: CorrelographyNet, targets: torch.Tensor, seed: int, chunk: int) -> dict[str, np.ndarray]:
    """Estimates at noise of every kind, as they are read, and their classical reconstructions."""
    from invert.network.inference import denoise, observation, retrieved
    from invert.network.proposals import overview
    from invert.spectrum import read_measurement
    from invert.training.data import varied

    batch = varied(targets, CHUNK, torch.Generator().manual_seed((seed << 32) + chunk))
    read = [read_measurement(estimate.numpy()) for estimate in batch.seen.estimate]
    seen = observation(read)
    denoised = denoise(network, seen, 1)
    pictures = torch.stack([overview(retrieved(one, signal, QUALITY, seed, "cpu"))[0] if one.detectable else nothing
                            for one, signal, nothing in zip(read, denoised, seen.classical, strict=True)])
    return {
        "albedo": (255.0 * batch.truth).round().to(torch.uint8).numpy(),
        "classical": (255.0 * pictures).round().to(torch.uint8).numpy(),
        "estimate": seen.estimate.half().numpy(),
        "denoised": denoised.half().numpy(),
        "floor": seen.floor.numpy(),
        "dof": seen.dof.numpy(),
    }


def load_warm_starts(addresses: Sequence[str]) -> dict[str, torch.Tensor]:
    """All samples of one store or more, in memory; InputError where one is missing or unfinished."""
    parts = []
    for address in addresses:
        try:
            group = zarr.open_group(address, mode="r")
            if not np.asarray(group["complete"]).all():
                raise InputError("--warm", "a complete store", f"an unfinished one at {address}",
                                 "run the same python -m invert.warm_starts again")
            parts.append({name: np.asarray(group[name]) for name in ARRAYS})
        except (OSError, KeyError):
            raise InputError("--warm", "a store that python -m invert.warm_starts wrote", f"none at {address}",
                             "check the address") from None
    return {name: torch.from_numpy(np.concatenate([part[name] for part in parts])) for name in ARRAYS}


def split_warm_starts(stored: dict[str, torch.Tensor]) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """Samples to train with, and the last twentieth held out."""
    kept = len(stored["albedo"]) - max(1, len(stored["albedo"]) // 20)
    return {name: value[:kept] for name, value in stored.items()}, {name: value[kept:] for name, value in stored.items()}
