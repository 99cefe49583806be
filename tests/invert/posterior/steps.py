"""An asymmetric object of three brightnesses, a wrong turn of it, and a noisy measurement of the right one."""

from functools import lru_cache

import torch

from invert.measure.spectrum import Measurement, read_measurement
from invert.training.data import at_noise


def steps(*blocks: tuple[int, int, int, int]) -> torch.Tensor:
    """Blocks (row, column, height, width), each brighter than the last; (64, 64)."""
    image = torch.zeros(64, 64)
    for number, (row, column, height, width) in enumerate(blocks, 2):
        image[row : row + height, column : column + width] = number / (len(blocks) + 1)
    return image


RIGHT = steps((14, 20, 30, 5), (14, 25, 5, 17), (27, 25, 5, 11))
MIRRORED_STEM = steps((14, 37, 30, 5), (14, 20, 5, 17), (27, 20, 5, 11))


@lru_cache(maxsize=1)
def noisy() -> Measurement:
    """`RIGHT` at a floor of 0.3 and K 64."""
    estimate = at_noise(RIGHT[None], 0.3, 64.0, torch.Generator().manual_seed(2)).seen.values[0]
    return read_measurement(estimate.numpy())
