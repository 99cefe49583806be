"""`correlograph doctor`: list missing components and the features that they affect."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from correlograph.command import ArgumentParser
from correlograph.errors import EXTRAS

PACKAGES = ("correlograph", "mitsuba", "drjit", "torch", "numpy", "OpenEXR", "finufft", "zarr", "dask")

_SIMULATOR = """
import sim, mitsuba as mi
from sim.backend.libllvm import MIN_LLVM_VERSION, NAME, newest
from sim.backend.variant import llvm_major
import drjit as dr, os
dr.eval(dr.sin(mi.Float(1.0)))
major = llvm_major()
print(mi.variant())
print(os.environ.get(NAME) or (newest() or [""])[0])
print("" if major is None else major)
print(MIN_LLVM_VERSION)
"""


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="correlograph doctor", description="What this machine has, and what missing pieces cost.")
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Print one line per component; exit with 1 if frames cannot be rendered or reconstructed."""
    parser().parse_args(argv)
    healthy = all([_python(), _packages(), _simulator(), _torch(), _weights()])
    sys.exit(0 if healthy else 1)


def _tell(name: str, found: str, costs: str = "") -> bool:
    print(f"{name:<10} {found}{f'; {costs}' if costs else ''}")
    return True


def _python() -> bool:
    enough = sys.version_info >= (3, 11)
    return _tell("Python", platform.python_version(), "" if enough else "3.11 or newer is needed") and enough


def _packages() -> bool:
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "missing"
    missing = [package for package, number in found.items() if number == "missing"]
    _tell(
        "packages",
        ", ".join(f"{package} {number}" for package, number in found.items()),
        f"pip install 'correlograph[all]' brings {', '.join(missing)}" if missing else "",
    )
    return not set(missing) - set(EXTRAS)


def _simulator() -> bool:
    """Check the simulator in another process, because a libLLVM can end the process that loads it."""
    done = subprocess.run([sys.executable, "-c", _SIMULATOR], capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
        reason = reason.removeprefix("correlograph.errors.InputError: ")
        return not _tell("simulator", f"does not start ({reason})", "inverting works, rendering does not")
    variant, path, major, enough = done.stdout.splitlines()[-4:]
    if variant.startswith("llvm"):
        _tell(
            "libLLVM",
            f"{major or 'of unknown version'}{f' ({path})' if path else ''}",
            f"below {enough}, spheres, smooth meshes, masks and microfacets are refused; 'apt-get install libllvm19', "
            "'dnf install llvm-libs' or 'brew install llvm'"
            if major and int(major) < int(enough)
            else "",
        )
    return _tell("Mitsuba", f"variant {variant}")


def _torch() -> bool:
    if find_spec("torch") is None:
        return not _tell("torch", "missing", "neither rendering nor inverting works")
    import torch

    if torch.cuda.is_available():
        _tell(
            "GPU",
            torch.cuda.get_device_name(),
            "" if find_spec("cufinufft") else "no cufinufft: --propagator nufft runs on the CPU only",
        )
    else:
        _tell("GPU", "none", "--device cuda is refused; everything runs on the CPU, training takes hours instead of minutes")
    return _tell(
        "threads",
        f"{torch.get_num_threads()} of torch for frames and training (OMP_NUM_THREADS); each reconstruction runs on one",
    )


def _weights() -> bool:
    spec = find_spec("invert")
    file = Path(spec.origin).parent / "weights" / "unet.safetensors" if spec and spec.origin else None
    if file is None or not file.is_file():
        return not _tell("weights", f"no {file}", "--method unet does not work, classical ones do")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    shipped = digest in file.with_suffix(".md").read_text()
    return _tell("weights", f"{file}, SHA-256 {digest}", "" if shipped else "not those that its card describes") and shipped
