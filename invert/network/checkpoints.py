"""Weights files: safetensors with metadata in the header; never a pickle."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from correlograph.errors import InputError
from correlograph.files.output import atomic
from invert.network.confidence import is_calibration
from invert.network.despeckler import Despeckler
from invert.network.model import CorrelographyNet
from invert.network.paper_unet import PaperModulusUnet, PaperUnet

DESPECKLER_WEIGHTS = Path(__file__).parents[1] / "weights" / "despeckler.safetensors"

NETWORKS: dict[str, type[nn.Module]] = {
    "unet": CorrelographyNet,
    "paper": PaperUnet,
    "paper-modulus": PaperModulusUnet,
    "despeckler": Despeckler,
}

RECONSTRUCTING = ("unet", "paper", "paper-modulus")
"""Networks that reconstruct an estimate."""


PARTS = ("denoiser", "sketch", "fusion", "sampler")
"""Parts of the default network in the order in which they are trained."""


def untrained_parts(card: dict[str, Any]) -> list[str]:
    """Return the parts of the default network that neither the run of a card nor one of its earlier runs has trained."""
    if card.get("network") != "unet":
        return []
    trained, run = set(), card.get("run")
    while isinstance(run, dict):
        trained.add(run.get("part"))
        earlier = run.get("start_from")
        run = earlier.get("run") if isinstance(earlier, dict) else None
    return [part for part in PARTS if part not in trained]


def save_weights(path: Path, tensors: dict[str, torch.Tensor], card: dict[str, Any]) -> None:
    """Write tensors with metadata (strict JSON) in the header; the file appears only when it is complete."""
    tensors = {name: value.contiguous() for name, value in tensors.items()}
    metadata = {"card": json.dumps(card, allow_nan=False), "sha256": _sha256(tensors)}
    with atomic(path) as partial:
        save_file(tensors, partial, metadata=metadata)
        partial.chmod(0o644)  # safetensors restricts the file to its owner


def read_weights(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read tensors and metadata of a file. Raises InputError for a damaged or foreign file."""
    if not path.is_file():
        raise InputError("--weights", "a .safetensors file", f"no {path}", "check the path")
    try:
        with safe_open(path, framework="pt") as stored:
            metadata = stored.metadata() or {}
            card = json.loads(metadata["card"])
            if not isinstance(card, dict):
                raise ValueError("no card")
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 - no mapping
            if "sha256" in metadata and metadata["sha256"] != _sha256(tensors):  # files of older versions have no digest
                raise ValueError("damaged")
    except (SafetensorError, KeyError, ValueError, OSError) as error:
        raise InputError(
            "--weights",
            "weights that python -m invert.train wrote",
            f"{path} ({type(error).__name__})",
            "train again or use the shipped ones",
        ) from None
    return tensors, card


def _sha256(tensors: dict[str, torch.Tensor]) -> str:
    whole = hashlib.sha256()
    for name, value in sorted(tensors.items()):
        whole.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        whole.update(value.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return whole.hexdigest()


@lru_cache(maxsize=4)
def load_network(path: Path, device: str = "cpu", kinds: tuple[str, ...] = RECONSTRUCTING) -> tuple[nn.Module, dict[str, Any]]:
    """Load a network of one of some kinds, and its metadata."""
    tensors, card = read_weights(path)
    kind, width = card.get("network"), card.get("width")
    if not isinstance(kind, str) or kind not in kinds or type(width) is not int or not 8 <= width <= 512 or width % 8:
        raise InputError(
            "--weights",
            f"a network of kind {', '.join(kinds)} and a width divisible by 8",
            f"{kind!r:.40} of width {width!r:.20} in {path}",
            "use other weights",
        )
    with torch.device("meta"):
        network = NETWORKS[kind](width)
    wanted = {name: value.shape for name, value in network.state_dict().items()}
    found = {name: value.shape for name, value in tensors.items()}
    if wanted != found:
        names = sorted(name for name in {**wanted, **found} if wanted.get(name) != found.get(name))
        raise InputError(
            "--weights",
            f"the tensors of {kind} of width {width}",
            f"{len(names)} others, {names[0]} first, in {path}",
            "use weights of this version",
        )
    kinds = {name: value.is_floating_point() for name, value in network.state_dict().items()}
    if any(tensors[name].is_floating_point() != floating for name, floating in kinds.items()):
        raise InputError("--weights", "floating-point weights", f"integers in {path}", "train again or use the shipped ones")
    tensors = {name: value.float() if kinds[name] else value for name, value in tensors.items()}
    if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
        raise InputError("--weights", "finite weights", f"NaN or infinity in {path}", "train again")
    if not is_calibration(card.get("calibration", {})):
        raise InputError("--weights", "a calibration as invert.calibrate writes it", f"another in {path}", "calibrate again")
    network.load_state_dict(tensors, assign=True)
    return network.to(device=device, memory_format=torch.channels_last).eval(), card
