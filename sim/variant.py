"""Which Mitsuba variant the simulator runs on, and the one clear line when none can run."""

from __future__ import annotations

from radiometry.errors import InputError
from radiometry.output import silenced

with silenced():  # a missing libLLVM is told by `activate_variant`, on one line
    import drjit as dr
    import mitsuba as mi


def activate_variant() -> str:
    """Keep the variant that is set; otherwise set `cuda_ad_mono` where a GPU works, else `llvm_ad_mono`.

    Raises InputError when the variant set is not a vectorised one, or when libLLVM is missing.
    """
    current = mi.variant()
    if current is None:
        if dr.has_backend(dr.JitBackend.CUDA):
            mi.set_variant("cuda_ad_mono")
        elif dr.has_backend(dr.JitBackend.LLVM):
            mi.set_variant("llvm_ad_mono")
        else:
            raise InputError("libLLVM", "a system libLLVM (or a CUDA GPU) for Mitsuba to compile with", "neither",
                             "install it: 'apt-get install libllvm15' on Debian and Ubuntu, 'brew install llvm' on "
                             "macOS, or set DRJIT_LIBLLVM_PATH")
    elif not current.startswith(("llvm", "cuda")):
        raise InputError("Mitsuba variant", "an llvm_* or cuda_* variant", current,
                         "call mi.set_variant('llvm_ad_mono') before 'import sim'")
    return mi.variant()
