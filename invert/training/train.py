"""`python -m invert.train DATASET -o WEIGHTS.safetensors`: train a network; runs resume exactly.

The data of every step depend on the seed and the step alone. A stopped run therefore continues as if it had not been stopped (to the
last bit with the same number of threads), and several GPUs (torchrun) share the data that one would process. The sampler is an
exception: each process has its own chains, and a checkpoint holds those of the first.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import torch

from correlograph.command import ArgumentParser
from correlograph.errors import InputError, check_device, memory_bytes
from correlograph.files.manifest import claim
from correlograph.files.output import sole_writer
from correlograph.ranges import SEED, Range
from invert.network.checkpoints import NETWORKS, PARTS, read_weights, untrained_parts
from invert.training.losses import LOSSES
from invert.training.training_loop import Training

BYTES_PER_CHANNEL = 3e5
"""Memory of a sample and its gradients per channel of width: 9 to 12 MB measured at width 40."""


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m invert.train", description="Train a network on a dataset's targets.")
    p.add_argument(
        "dataset",
        nargs="+",
        help="datasets made by python -m data_gen, of any numbers of lags; steps alternate between them and use the targets only",
    )
    p.add_argument(
        "-o", "--output", required=True, type=Path, help="weights, .safetensors; a checkpoint is kept in the same folder"
    )
    p.add_argument(
        "--network",
        choices=tuple(NETWORKS),
        default="unet",
        help="architecture to train (unet); paper and paper-modulus are those of Metzler et al. 2020; despeckler is that of the fields",
    )
    p.add_argument(
        "--width",
        type=Range(8, 512, 8),
        help="channels at full resolution (40; 64 for the networks of Metzler et al. 2020, 32 for the despeckler)",
    )
    p.add_argument(
        "--part",
        choices=PARTS,
        default="denoiser",
        help="part of the network unet to train (denoiser)",
    )
    p.add_argument(
        "--loss",
        choices=tuple(LOSSES),
        default="registered",
        help="loss between reconstruction and target; the denoiser always uses its own",
    )
    p.add_argument(
        "--noise",
        choices=("varied", "paper"),
        default="varied",
        help="noise levels: a wide range (varied), or those of Metzler et al. 2020 (paper)",
    )
    p.add_argument("--warm", nargs="+", help="stores of python -m invert.warm_starts, for the fusion")
    p.add_argument("--start-from", type=Path, help="weights of an earlier run to begin with")
    p.add_argument("--steps", type=Range(1, 10**8), default=6000, help="number of training steps (6000)")
    p.add_argument("--checkpoint-every", type=Range(1, 10**8), default=250, metavar="STEPS")
    p.add_argument("--batch", type=Range(1, 65536), default=32, help="targets per step (32)")
    p.add_argument("--workers", type=Range(0, 1024), default=0, help="processes that draw the batches; 0: this one (0)")
    p.add_argument("--learning-rate", type=Range(1e-12, 1.0), default=1e-3)
    p.add_argument("--seed", type=SEED, default=0)
    p.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    p.add_overwrite()
    return p


OUTPUT_SUFFIXES = (".safetensors", ".checkpoint.safetensors", ".png", ".json")
"""Endings of the files that a training run writes."""


def main(argv: Sequence[str] | None = None) -> None:
    """Load targets, train, and write the weights with metadata, curve and checkpoint."""
    options = parser().parse_args(argv)
    _check(options)
    rank, world = _join_processes(options.device)
    with sole_writer(options.output, "-o") if rank == 0 else nullcontext():
        _train(options, rank, world)


def _train(options: Any, rank: int, world: int) -> None:
    from tqdm import tqdm

    from data_gen.dataset import load_targets, manifest

    pairs = [load_targets(address) for address in options.dataset]
    targets, held_out = ([pair[which] for pair in pairs] for which in (0, 1))
    training = Training(options, rank, world)
    training.resume()
    if rank == 0 and training.step:
        print(f"continues at step {training.step} of {options.steps}", file=sys.stderr)
    targets, validation = training.place(targets), training.validation(held_out)
    with tqdm(total=options.steps, initial=training.step, unit="step", disable=None if rank == 0 else True) as bar:
        for batch in training.batches(targets):
            loss = training.advance(batch)
            bar.update()
            bar.set_postfix(loss=f"{loss:.3f}", refresh=False)
            if training.step % options.checkpoint_every == 0 or training.step == options.steps:
                training.note(loss, validation)
                if rank == 0:
                    training.checkpoint()
                    bar.write(training.last_line())
    if rank == 0:
        training.finish([manifest(address) for address in options.dataset])
        missing = untrained_parts(read_weights(options.output)[1])
        hint = f"; not trained yet: {', '.join(missing)} (docs/methods.md, Training)" if missing else ""
        print(f"{options.output}, {options.output.with_suffix('.png').name} and .json{hint}")


def _join_processes(device: str) -> tuple[int, int]:
    """Return rank and number of processes started by torchrun."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world > 1:
        torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
        if device == "cuda":
            torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    return int(os.environ.get("RANK", "0")), world


def _check(options: Any) -> None:
    check_device(options.device)
    if options.width is None:
        options.width = {"unet": 40, "despeckler": 32}.get(options.network, 64)
    if options.workers and options.network == "despeckler":
        raise InputError("--workers", "0 for the despeckler, whose batches are drawn on --device", options.workers, "remove it")
    wanted = options.batch * options.width * BYTES_PER_CHANNEL
    if wanted > memory_bytes():
        raise InputError(
            "--batch, --width",
            f"activations that fit into {memory_bytes() / 1e9:.1f} GB",
            f"about {wanted / 1e9:.3g} GB",
            "lower one of them",
        )
    least = 2 * int(os.environ.get("WORLD_SIZE", "1")) if options.part == "sampler" else 1
    if options.batch < least:
        raise InputError("--batch", f"{least} or more for the sampler, two for each process", options.batch, "raise it")
    fuses = options.network == "unet" and options.part == "fusion"
    if bool(options.warm) != fuses or (fuses and (options.noise == "paper" or options.start_from is None)):
        raise InputError(
            "--part fusion",
            "--warm STORES, --start-from WEIGHTS and --noise varied together with it",
            f"--part {options.part}, {options.warm}, {options.start_from}, {options.noise}",
            "train denoiser and sketch, each from the last, then the fusion",
        )
    if options.output.suffix != ".safetensors":
        raise InputError("-o", "a name that ends in .safetensors", options.output, "use another name")
    if not options.output.parent.is_dir():
        raise InputError("-o", "an existing folder", options.output.parent, "create it")
    names = [options.output.with_suffix(suffix).name for suffix in OUTPUT_SUFFIXES]
    claim(options.output.parent, names, overwrite=options.overwrite)
