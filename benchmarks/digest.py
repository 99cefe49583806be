"""`python -m benchmarks.digest`: SHA-256 of frames, estimates, weights and albedos, to compare two versions of the code.

Moving or renaming code does not change the digests on the same machine with the same number of threads.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

import invert
import sim
from sim.plan import Settings

SCENES = ("corner_letter", "two_depths", "tilted_letter", "strong_ambient")
METHODS = ("unet", "classical", "hio", "raar", "er", "altmin", "twf", "taf", "mtwf", "admm-tv")


def digest(array: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:16]


def main() -> None:
    found: dict[str, str] = {}
    for name in SCENES:
        capture = sim.render(name, frames=2, seed=1)
        found[f"{name} frames"] = digest(np.stack(capture.frames))
        found[f"{name} truth"] = digest(capture.truth)
        result = invert.reconstruct(capture, quality="fast")
        found[f"{name} estimate"] = digest(result.estimate.values)
        found[f"{name} unet fast"] = digest(result.albedo)
    exact = Settings("field", 1e-3, "fresnel")
    found["corner_letter field"] = digest(sim.wall_field("corner_letter", 2, settings=exact))
    capture = sim.render("corner_letter", frames=2, seed=1)
    for method in METHODS:
        quality = "balanced" if method == "unet" else "fast"
        found[f"corner_letter {method} {quality}"] = digest(invert.reconstruct(capture, method=method, quality=quality).albedo)
    shipped = next(Path(invert.__file__).parent.glob("weights/*.safetensors"))
    found["weights"] = hashlib.sha256(shipped.read_bytes()).hexdigest()[:16]
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
