"""The bar target: shipped file, contrast of the target and of a blurred one."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from data_gen.bars import PIXELS, SIDE_M, bar_contrast, bar_groups, bar_target, main
from scenes import scene_path


def test_the_shipped_bitmap_is_the_target(command, tmp_path):
    shipped = np.asarray(Image.open(scene_path("bar_target").with_name("bars.png")))
    assert np.array_equal(shipped, bar_target())
    assert command(main, tmp_path / "bars.png")[0] == 0
    assert np.array_equal(np.asarray(Image.open(tmp_path / "bars.png")), shipped)


def test_groups_do_not_overlap():
    total = sum(5 * group.width_m * group.length_m for group in bar_groups())
    assert bar_target().mean() / 255.0 == pytest.approx(total / SIDE_M**2, rel=0.01)
    assert not bar_target()[-10:].any()


def test_contrast_falls_as_the_transfer_of_a_blur():
    """A Gaussian blur multiplies the wave of a period by exp(-2 (pi sigma / period)^2)."""
    sigma_m = 25e-6
    blurred = ndimage.gaussian_filter(bar_target().astype(np.float64), sigma_m * PIXELS / SIDE_M)
    for group in bar_groups():
        assert bar_contrast(bar_target().astype(np.float64), group) == pytest.approx(1.0, abs=0.02)
        expected = np.exp(-2.0 * (np.pi * sigma_m / (2.0 * group.width_m)) ** 2)
        assert bar_contrast(blurred, group) == pytest.approx(expected, abs=0.03)
