"""The gain of a camera from its frames, against the gain with which they were drawn."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from radiometry.estimation.photon_transfer import PhotonTransfer, combine, photon_transfer, shot_noise


def frame(rng, photons: float, gain: float, read: float, offset: float, shape=(701, 850)) -> torch.Tensor:
    """Grains about eight pixels wide, in digital numbers."""
    field = gaussian_filter(rng.standard_normal((2, *shape)), (0, 4, 4))
    light = (field**2).sum(0)
    counts = rng.poisson(photons * light / light.mean()) + read * rng.standard_normal(shape)
    return torch.from_numpy(gain * counts + offset).float()


@pytest.mark.parametrize(
    ("photons", "gain", "read", "offset"),
    [(5.0, 1.0, 0.0, 0.0), (0.3, 0.4, 1.5, 100.0), (40.0, 2.5, 3.0, 7.0), (0.05, 1.0, 0.2, 0.0)],
)
def test_the_gain_is_found(rng, photons, gain, read, offset):
    """Within its error, with read noise and an offset; the variance is that of all noise."""
    found = photon_transfer(frame(rng, photons, gain, read, offset))
    assert abs(found.gain - gain) < 4.0 * found.error
    assert found.error < 0.5 * gain
    assert found.variance == pytest.approx(gain**2 * (photons + read**2), rel=0.05)


def test_the_error_is_that_of_repetitions(rng):
    found = [photon_transfer(frame(rng, 1.0, 1.0, 1.0, 0.0, (300, 340))) for _ in range(24)]
    scatter = np.std([one.gain for one in found], ddof=1)
    assert np.mean([one.error for one in found]) == pytest.approx(scatter, rel=0.5)
    assert combine(found).error == pytest.approx(scatter / 24**0.5, rel=0.5)


def test_even_light_tells_nothing_about_the_gain(rng):
    found = photon_transfer(torch.from_numpy(rng.poisson(1.0, (400, 500))).float())
    assert shot_noise(found, 1.0, 1.0).error > 0.2


def test_shot_noise_is_no_more_than_all_noise():
    assert shot_noise(PhotonTransfer(1.0, 0.01, 3.0), 2.0, 3.0) == PhotonTransfer(1.0, 0.01, 2.0)  # one electron of read noise
    assert shot_noise(PhotonTransfer(0.3, 0.01, 0.4), 100.0, 0.4) == PhotonTransfer(0.3, 0.01, 0.4)  # the level holds an offset
    assert shot_noise(PhotonTransfer(0.0, np.inf, 0.4), 1.0, 0.4) == PhotonTransfer(0.2, 0.2, 0.2)  # anything is possible
    assert shot_noise(PhotonTransfer(9.0, 0.01, 9.0), 1.0, 0.4) == PhotonTransfer(0.4, 0.0, 0.4)  # grains of one pixel
