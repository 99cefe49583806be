"""The error that users meet, and checks that raise it."""

from __future__ import annotations

import os

MAX_FOUND_CHARS = 300
"""Maximum length of the found value in a message."""


class InputError(ValueError):
    """Error for unusable input; its one-line message states name, expectation, finding and remedy. The message is always one
    line, because commands print it as it is.
    """

    def __init__(self, name: str, expected: str, found: object, remedy: str) -> None:
        found = f"{found!s:.{MAX_FOUND_CHARS}}" + ("..." if len(str(found)) > MAX_FOUND_CHARS else "")
        text = f"{name}: expected {expected}, found {found}; {remedy}".encode("utf-8", "replace").decode()
        super().__init__(" ".join(text.split()))
        self._parts = (name, expected, str(found), remedy)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Support pickling between worker processes."""
        return type(self), self._parts


EXTRAS = {
    **dict.fromkeys(("mitsuba", "drjit", "trimesh", "finufft"), "sim"),
    **dict.fromkeys(("OpenEXR", "h5py", "astropy"), "files"),
    **dict.fromkeys(("zarr", "numcodecs"), "data"),
    **dict.fromkeys(("dask", "distributed"), "cluster"),
}
"""The optional dependency group of pyproject.toml that installs a package."""


def missing_package(error: ModuleNotFoundError) -> Exception:
    """Return an InputError that names the group of a missing optional package; the error itself for any other module."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return error
    return InputError(package, "this package, which is optional", "none", f"pip install 'correlograph[{EXTRAS[package]}]'")


SI_MAX = 1e15
SI_MIN = 1e-30


def check_positive(name: str, value: float, *, zero_allowed: bool = False) -> float:
    """Return `value` as a float if it lies between 1e-30 and 1e15 (or zero, with `zero_allowed`).

    Raises InputError for anything else, including NaN, text and truth values.
    """
    try:
        number = float("nan") if isinstance(value, (bool, str, bytes)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if SI_MIN <= number <= SI_MAX or (zero_allowed and number == 0.0):
        return number
    kind = f"a number{' that is zero or' if zero_allowed else ''} between {SI_MIN:g} and {SI_MAX:g}"
    raise InputError(name, kind, repr(value) if isinstance(value, (str, bytes)) else value, f"correct {name}")


def memory_bytes() -> float:
    """Return the memory of this machine; infinity where the system does not tell."""
    if not hasattr(os, "sysconf"):
        return float("inf")
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def check_device(device: str) -> None:
    """Refuse another device than `cpu` and `cuda`, and `cuda` if torch finds no GPU."""
    if not isinstance(device, str) or device not in ("cpu", "cuda"):
        raise InputError("--device", "cpu or cuda", repr(device), "use one of these")
    if device == "cuda":
        import torch  # a slow import

        if not torch.cuda.is_available():
            raise InputError("--device", "a CUDA GPU and a torch build that uses it", "none", "use --device cpu")
