"""The central lobe of the power of the speckle is that of the objects, without their interference."""

import numpy as np
import pytest

import correlograph as cg
from invert.tracking.central_lobe import central_lobe
from invert.tracking.tracker import _read_spectra
from tests.invert.field.speckle import letter, travelling_fields

PLACES = [(-9, -15), (11, 13)]


@pytest.fixture(scope="module")
def lights():
    """Light of two letters beside each other, and their interference, of three frames, (3, 260, 330) each."""
    rng, path = np.random.default_rng(3), np.array([[0.0, 0.0], [2.0, -1.0], [4.0, -2.0]])
    albedos = (np.roll(letter(size=size), place, (0, 1)) for size, place in zip((22, 16), PLACES, strict=True))
    one, other = (np.stack(travelling_fields(albedo, (260, 330), 128, rng, path, 1e6)) for albedo in albedos)
    return np.abs(one) ** 2 + np.abs(other) ** 2, 2.0 * (one * other.conj()).real


def power_in(band, image):
    """Return the power of images (frames, rows, columns) at the frequencies of a band, without that of their mean."""
    spectrum = np.abs(np.fft.rfft2(image - image.mean())) ** 2
    rows = np.round(band.rows * image.shape[1]).astype(int)
    return (band.counts * spectrum[:, rows, : len(band.columns)]).sum()


def test_the_central_lobe_holds_objects_without_their_interference(lights):
    own, interference = lights
    frames = np.random.default_rng(4).poisson(3.0 * (own + interference)).astype(np.float32)
    _, band = _read_spectra(cg.Capture(list(frames)), 1)
    assert power_in(central_lobe(band), own) > 0.95 * power_in(band, own)
    assert power_in(central_lobe(band), interference) < 0.05 * power_in(band, interference)
    assert central_lobe(band).power == pytest.approx(0.5 * band.power, rel=0.2)  # of two equal lights


def test_speckle_without_interference_is_one_lobe(lights):
    frames = np.random.default_rng(4).poisson(3.0 * lights[0]).astype(np.float32)
    _, band = _read_spectra(cg.Capture(list(frames)), 1)
    assert central_lobe(band) is band


@pytest.mark.parametrize("side", [25, 45])
def test_noise_does_not_split_the_lobe_of_an_object(side):
    """A square in frames that share one pattern of few grains, whose power is noisy."""
    square = np.zeros((64, 64))
    square[4 : 4 + side, 9 : 9 + side] = 1.0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        (field,) = travelling_fields(square, (180, 220), 128, rng, np.zeros((1, 2)), 1e6)
        _, band = _read_spectra(cg.Capture([rng.poisson(3.0 * np.abs(field) ** 2).astype(np.float32) for _ in range(3)]), 1)
        assert central_lobe(band) is band


def test_the_band_of_dim_frames_is_left_whole(lights):
    own, interference = lights
    frames = np.random.default_rng(4).poisson(0.003 * (own + interference)).astype(np.float32)
    _, band = _read_spectra(cg.Capture(list(frames)), 1)
    assert band.is_dim
    assert central_lobe(band) is band
