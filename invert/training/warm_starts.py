"""`python -m invert.warm_starts TARGETS.zarr --weights DENOISER.safetensors -o WARM.zarr`: precompute inputs of the fusion.

They are noisy estimates, denoised, with the classical reconstructions of each. Runs resume.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from correlograph.command import ArgumentParser
from correlograph.errors import InputError
from correlograph.files.output import sole_writer
from correlograph.files.store import Schema, begin, missing_parts, open_complete, read_array, store_address, write_part
from correlograph.lags import LAG_SIDE
from correlograph.ranges import SEED, Range
from invert.network.features import PICTURES

if TYPE_CHECKING:
    from invert.network.model import CorrelographyNet

CHUNK = 32
"""Number of entries that are computed and stored together."""
ARRAYS: dict[str, tuple[tuple[int, ...], str]] = {
    "albedo": ((64, 64), "uint8"),
    "classical": ((PICTURES, 64, 64), "uint8"),
    "estimate": ((LAG_SIDE, LAG_SIDE), "float16"),
    "denoised": ((LAG_SIDE, LAG_SIDE), "float16"),
    "floor": ((), "float32"),
    "dof": ((), "float32"),
}

SCHEMA = Schema("warm starts", "python -m invert.warm_starts", 2, ARRAYS, CHUNK, CHUNK)


def parser() -> ArgumentParser:
    p = ArgumentParser(
        prog="python -m invert.warm_starts",
        description="Precompute classical reconstructions as inputs for the training of the fusion network.",
    )
    p.add_argument("targets", help="dataset made by python -m data_gen")
    p.add_argument("-o", "--output", required=True)
    p.add_argument("--weights", required=True, type=Path, help="a trained denoiser, .safetensors")
    p.add_argument("--count", type=Range(CHUNK, 10**8, CHUNK), default=12800)
    p.add_argument("--seed", type=SEED, default=0)
    return p


def main(argv: Sequence[str] | None = None) -> None:
    options = parser().parse_args(argv)
    from tqdm import tqdm

    from data_gen.dataset import load_targets
    from invert.network.checkpoints import load_network
    from invert.network.model import CorrelographyNet

    network, card = load_network(options.weights)
    if not isinstance(network, CorrelographyNet):
        raise InputError("--weights", "a network with a denoiser", f"the kind {card['network']}", "train --network unet")
    targets, _ = load_targets(options.targets)
    arguments = {"targets": options.targets, "seed": options.seed, "count": options.count, "denoiser": card["run"]}
    address = store_address(options.output)
    with sole_writer(address, "warm starts"):
        group = begin(address, SCHEMA, arguments, options.count)
        missing = missing_parts(group, address, SCHEMA)
        chunks = options.count // CHUNK
        for chunk in tqdm(missing, total=chunks, initial=chunks - len(missing), unit="chunk", disable=None):
            write_part(group, SCHEMA, chunk, _chunk(network, targets, options.seed, chunk))


def _chunk(network: CorrelographyNet, targets: torch.Tensor, seed: int, chunk: int) -> dict[str, np.ndarray]:
    """Return estimates at noise of every kind, with their classical reconstructions."""
    from invert.choices import FAST
    from invert.measure.spectrum import read_measurement
    from invert.network.inference import denoise, make_observation, run_phase_retrieval
    from invert.network.retrieval_summary import summarise_retrievals
    from invert.training.data import make_varied_batch

    batch = make_varied_batch(targets, CHUNK, torch.Generator().manual_seed((seed << 32) + chunk))
    read = [read_measurement(estimate.numpy()) for estimate in batch.seen.values]
    seen = make_observation(read)
    denoised = denoise(network, seen, 1)
    pictures = torch.stack(
        [
            summarise_retrievals(run_phase_retrieval(one, signal, FAST.network_starts, seed, "cpu"))[0]
            if one.detectable
            else nothing
            for one, signal, nothing in zip(read, denoised, seen.classical, strict=True)
        ]
    )
    return {
        "albedo": (255.0 * batch.truth).round().to(torch.uint8).numpy(),
        "classical": (255.0 * pictures).round().to(torch.uint8).numpy(),
        "estimate": seen.values.half().numpy(),
        "denoised": denoised.half().numpy(),
        "floor": seen.floor.numpy(),
        "dof": seen.dof.numpy(),
    }


def load_warm_starts(addresses: Sequence[str]) -> dict[str, torch.Tensor]:
    """Load all samples of one store or more into memory. Raises InputError if one is missing or unfinished."""
    parts = []
    for address in addresses:
        group = open_complete(address, SCHEMA)
        parts.append({name: read_array(group, address, name, SCHEMA) for name in ARRAYS})
    return {name: torch.from_numpy(np.concatenate([part[name] for part in parts])) for name in ARRAYS}


def split_warm_starts(stored: dict[str, torch.Tensor]) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """Return the samples for training, and the last twentieth for validation."""
    kept = len(stored["albedo"]) - max(1, len(stored["albedo"]) // 20)
    return {name: value[:kept] for name, value in stored.items()}, {name: value[kept:] for name, value in stored.items()}
