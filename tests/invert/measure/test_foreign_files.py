"""Sample files that other packages ship for their own tests: read as these packages read them, or refused in one line."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import skimage.io

from correlograph.errors import InputError
from correlograph.files.stacks import FITS_KINDS, HDF5_KINDS, open_stack

PACKAGES = ("astropy", "h5py", "skimage", "scipy", "numpy")
KINDS = {".tif", ".tiff", ".png", ".npy", ".npz", *FITS_KINDS, *HDF5_KINDS}


def _samples() -> list[Path]:
    folders = [Path(spec.origin).parent for name in PACKAGES if (spec := find_spec(name)) and spec.origin]
    return [file for folder in folders for file in sorted(folder.rglob("*")) if file.suffix.lower() in KINDS]


def _read_by_owner(file: Path) -> np.ndarray:
    """Return the only array of a file, as the package that is made for this format reads it."""
    kind = file.suffix.lower()
    if kind == ".npz":
        with np.load(file) as archive:
            return archive[archive.files[0]]
    if kind == ".npy":
        return np.load(file)
    if kind in FITS_KINDS:
        from astropy.io import fits

        with fits.open(file) as units:
            return np.array(next(unit.data for unit in units if unit.is_image and unit.data is not None))
    return skimage.io.imread(file)


def _read(file: Path) -> np.ndarray | None:
    """Return the frames of a file; None if it is refused in one line."""
    try:
        stack = open_stack(file)
        return np.stack([stack.read(number)[0] for number in range(stack.count)])
    except InputError as refusal:
        if "\n" in str(refusal):
            raise
        return None


@pytest.mark.filterwarnings("ignore")  # the packages warn of their own damaged samples
def test_samples_of_other_packages_are_read_exactly_or_refused_in_one_line() -> None:
    samples = {file: _read(file) for file in _samples()}
    if len(samples) < 30:
        pytest.skip(f"the packages ship only {len(samples)} samples")
    for file, found in samples.items():
        if found is not None:
            expected = _read_by_owner(file)
            if expected.size != found.size:  # colour with equal channels
                assert (expected[..., :3] == expected[..., :1]).all(), file
                expected = expected[..., 0]
            expected = expected.reshape(found.shape).astype(np.float32)
            np.testing.assert_array_equal(found, expected, err_msg=str(file))
    read = sum(found is not None for found in samples.values())
    assert read >= 15
    assert len(samples) - read >= 15
