"""More than 64 lags: the command shows how much of the sampling is left."""

from typing import ClassVar

import numpy as np
import pytest

from invert.choices import QUALITIES
from invert.measure.estimate import Estimate
from invert.network import inference
from invert.network.finer_lags import finer_progress_steps
from invert.pipeline import reconstruct


class Bar:
    """Progress bar that remembers its title, its total and its steps."""

    shown: ClassVar[list["Bar"]] = []

    def __init__(self, total, desc, **_):
        self.total, self.title, self.done = total, desc, 0
        Bar.shown.append(self)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def update(self, steps=1):
        self.done += steps


@pytest.mark.slow
@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_progress_ends_at_its_total(quality, rng, monkeypatch):
    albedo = np.zeros((80, 80))
    albedo[20:60, 24:32] = albedo[20:28, 24:52] = albedo[38:46, 24:44] = 1.0
    power = np.abs(np.fft.fft2(albedo, (255, 255))) ** 2
    lags = np.fft.fftshift(np.fft.ifft2(power).real)[127 - 79 : 128 + 79, 127 - 79 : 128 + 79]
    lags = (lags / lags.max() + 0.05) * rng.gamma(300.0, 1.0 / 300.0, lags.shape)
    lags = 0.5 * (lags + lags[::-1, ::-1])
    monkeypatch.setattr(inference, "tqdm", Bar)
    Bar.shown.clear()
    result = reconstruct(Estimate("test", lags.astype(np.float32)), quality=quality)
    assert result.albedo.shape == (80, 80)
    (bar,) = Bar.shown
    assert bar.done == bar.total
    assert bar.total >= finer_progress_steps(QUALITIES[quality], 1)
    assert bar.title.startswith(("79 lags", "80 lags"))
    assert ("--quality fast" in bar.title) == (quality == "balanced")
