"""Ring correlation, and the resolution that speckle permits: closed form against drawn fields."""

import numpy as np
import pytest

from radiometry.ring_correlation import (
    MIN_CORRELATION_WITH_TRUTH,
    SpeckledImage,
    fourier_ring_correlation,
    half_period,
    ring_spectra,
    speckle_noise,
)

CELLS = (1.0, 1.25)


def fields(albedo, grain, looks, rng, fine=4):
    """Yield fields (rows, columns) of an albedo on cells of `CELLS`: a round spot's speckle times white scatter on finer points."""
    rows, columns = (fine * side for side in albedo.shape)
    sharp = np.sqrt(np.kron(albedo, np.ones((fine, fine))))
    down, right = (np.fft.fftfreq(side, cell / fine) for side, cell in zip((rows, columns), CELLS, strict=True))
    spot = np.hypot(down[:, None], right[None]) < 0.5 / grain
    inner = tuple(slice((fine - 1) * side // 2, (fine + 1) * side // 2) for side in albedo.shape)
    for _ in range(looks):
        light, scatter = rng.standard_normal((2, 2, rows, columns))
        light = np.fft.ifft2(np.fft.fft2(light[0] + 1j * light[1]) * spot)
        light /= np.sqrt((np.abs(light) ** 2).mean())
        seen = np.fft.fftshift(np.fft.fft2(sharp * light * (scatter[0] + 1j * scatter[1]), norm="ortho"))[inner]
        yield np.fft.ifft2(np.fft.ifftshift(seen), norm="ortho") * np.sqrt(0.5)


@pytest.mark.parametrize("grain", [0.15, 1.0, 1.7, 4.0])
def test_speckle_noise(rng, grain):
    """Uniform albedo: every ring of the spectrum of |E|^2 has the predicted power."""
    albedo = np.ones((48, 64))
    spectra = []
    for field in fields(albedo, grain, 30, rng):
        noise = np.abs(field) ** 2 / (np.abs(field) ** 2).mean() - 1.0
        frequency, (power, _, _) = ring_spectra(noise, noise, CELLS)
        spectra.append(power)
    window = np.outer(np.hanning(50)[1:-1], np.hanning(66)[1:-1])
    found = np.mean(spectra, 0) / (window**2).sum()
    expected = speckle_noise(frequency, CELLS[0] * CELLS[1], grain)
    low, high = frequency < 0.3 / grain, frequency > 1.0 / grain
    for part in (low, high):
        if part.sum() > 2:
            assert found[part].mean() == pytest.approx(expected[part].mean(), rel=0.2)


class Drawn:
    """Hidden object whose albedo is given."""

    def __init__(self, albedo):
        self.source, self.extent_m = albedo, tuple(side * cell for side, cell in zip(albedo.shape, CELLS, strict=True))

    def sample(self, pitches, shape):
        margins = [wanted - side for wanted, side in zip(shape, self.source.shape, strict=True)]
        self.albedo = np.pad(self.source, [(one // 2, one - one // 2) for one in margins])
        return self


def falling_pattern(rng, shape=(70, 90)):
    """Return a positive random pattern, whose amplitudes fall as the frequency to the power of -1.5."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None])
    pattern = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) * np.maximum(frequency, 0.02) ** -1.5).real
    return np.clip(1.0 + pattern / pattern.std(), 0.0, None)


@pytest.mark.parametrize(("grain", "looks"), [(0.2, 1), (0.2, 12), (1.7, 2), (1.7, 24)])
def test_expected_resolution_is_that_of_drawn_looks(rng, grain, looks):
    """A random pattern whose spectrum falls: half-period of the mean of drawn fields, median over ten draws."""
    albedo = falling_pattern(rng)
    hidden = Drawn(albedo)
    expected = SpeckledImage(hidden, CELLS, grain).half_period_m(looks)
    padded = hidden.sample(CELLS, tuple(side + 16 for side in albedo.shape)).albedo
    found = []
    for _ in range(10):
        mean = np.mean([np.abs(field) ** 2 for field in fields(padded, grain, looks, rng)], 0)
        found.append(half_period(mean, padded, CELLS, MIN_CORRELATION_WITH_TRUTH))
    assert np.median(found) == pytest.approx(expected, rel=0.3)


def test_more_looks_resolve_more(rng):
    hidden = Drawn(falling_pattern(rng))
    image = SpeckledImage(hidden, CELLS, 1.7)
    assert image.half_period_m(1) > image.half_period_m(8) >= image.half_period_m(64) >= 0.5 * max(CELLS)


@pytest.mark.parametrize("side", [20, 28, 40, 90])
def test_identical_images_are_resolved_on_grids_of_any_size(rng, side):
    image = rng.random((side, side + 3))
    assert half_period(image, image, (1.0, 1.0)) == pytest.approx(1.0, rel=0.06)


@pytest.mark.parametrize("cutoff", [0.1, 0.2, 0.3])
def test_resolution_is_the_band_limit_of_the_shared_signal(rng, cutoff):
    signal = np.fft.fft2(rng.standard_normal((160, 200)))
    frequency = np.hypot(np.fft.fftfreq(160)[:, None], np.fft.fftfreq(200)[None])
    shared = np.fft.ifft2(signal * (frequency < cutoff)).real
    halves = [shared + 0.3 * rng.standard_normal(shared.shape) for _ in range(2)]
    assert half_period(*halves, (2.0, 2.0)) == pytest.approx(1.0 / cutoff, rel=0.12)
    frequencies, correlation = fourier_ring_correlation(*halves, (2.0, 2.0))
    assert correlation[2.0 * frequencies < 0.8 * cutoff].min() > 0.5
