"""Interference of two objects, against its closed form."""

from __future__ import annotations

import numpy as np
import pytest

import correlograph as cg
from benchmarks.tracking_pairs import draw
from invert.tracking.interference import Together, apart, begin_interference, interference_tracks, maximise
from invert.tracking.likelihood import Likelihood
from invert.tracking.tracker import _read_spectra

SIDES, SHAPE, FRAMES = (420, 512), (300, 380), 16
VARIANCES, CENTRES = np.array([9.6e-4, 2.4e-4]), np.array([[0.04, -0.06], [-0.07, 0.03]])
VELOCITIES = np.array([[0.45, -0.2], [-0.25, 0.4]])
SHARE = VARIANCES[1] / VARIANCES.sum()
MEAN = VELOCITIES[0] + SHARE * (VELOCITIES[1] - VELOCITIES[0])
STEP = 0.1
TURN = CENTRES[1] @ (VELOCITIES[1] - MEAN) - CENTRES[0] @ (VELOCITIES[0] - MEAN)


def gaussian_objects(rng: np.random.Generator) -> list[np.ndarray]:
    """Return frames of two Gaussian objects of equal light, of different size, beside each other, whose fields travel and add."""
    frequencies = np.stack(np.meshgrid(*(np.fft.fftfreq(side) for side in SIDES), indexing="ij"), -1)
    frames = np.zeros((FRAMES, *SIDES), np.complex128)
    for variance, centre, velocity in zip(VARIANCES, CENTRES, VELOCITIES, strict=True):
        albedo = np.exp(-((frequencies - centre) ** 2).sum(-1) / (2.0 * variance))
        field = np.sqrt(albedo / albedo.sum()) * (rng.normal(size=SIDES) + 1j * rng.normal(size=SIDES))
        for number in range(FRAMES):
            frames[number] += np.fft.ifft2(field * np.exp(-2j * np.pi * number * (frequencies @ velocity))) * field.size
    seen = np.abs(frames[:, : SHAPE[0], : SHAPE[1]]) ** 2
    return list(rng.poisson(4.0 * seen / seen.mean()).astype(np.float32))


@pytest.fixture(scope="module")
def likelihood() -> Likelihood:
    spectra, band = _read_spectra(cg.Capture(gaussian_objects(np.random.default_rng(2))), 1)
    return Likelihood(spectra, band, 2**16)


def test_interference_moves_and_turns_by_the_closed_form(likelihood):
    paths = [np.arange(FRAMES)[:, None] * one for one in VELOCITIES]

    def rise(share: float, turn: float) -> float:
        """The frequencies of a band are half of all, and the conjugate has others."""
        return likelihood.rise([*paths, interference_tracks(*paths, share, turn)[0]])

    alone, found = likelihood.rise(paths), rise(SHARE, TURN)
    assert found > 1.4 * alone
    at_turns, at_shares = (
        [rise(SHARE, TURN + 0.01 * one) for one in (-2, -1, 1, 2)],
        [rise(share, TURN) for share in (0.5, 0.8, -0.1)],
    )
    assert found > 1.005 * max(at_turns)
    assert found - alone > 1.4 * (max(at_shares) - alone)


def test_objects_and_their_interference_are_found_together(likelihood):
    """Half of the power is interference, which draws both paths. That of the smaller object, with fewer grains, is still drawn."""
    numbers = np.arange(FRAMES)[:, None]
    begun = [numbers * (one + off) for one, off in zip(VELOCITIES, ((0.1, 0.12), (-0.1, 0.1)), strict=True)]
    found, without = (
        np.abs(np.stack(maximise(likelihood, one, STEP).paths)[:, -1] / (FRAMES - 1) - VELOCITIES)
        for one in (begin_interference(likelihood, begun), apart(begun))
    )
    assert found[0].max() < 0.05
    assert found.max() < 0.2
    assert without[0].max() > 0.2
    assert (without.max(1) > found.max(1)).all()


def test_tracks_of_objects_and_of_each_two_of_them(rng):
    paths = list(rng.normal(size=(3, 7, 2)))
    tracks = Together(paths, np.array([[0.25, 0.1], [0.5, 0.2], [1.0, 0.0]])).tracks
    assert len(tracks) == 9
    assert np.allclose(tracks[3][:, :2], 0.75 * paths[0] + 0.25 * paths[1])
    assert np.allclose(tracks[5][:, 2], 0.2 * np.arange(7))
    assert np.allclose(tracks[6][:, 2], -0.2 * np.arange(7))
    assert np.allclose(tracks[7][:, :2], paths[2])


def test_interference_between_two_objects_draws_no_path():
    """Without interference, one of the paths was off by 1.5 pixels."""
    frames, velocities, _ = draw(712, 2)
    found = cg.track(cg.Capture(frames))
    numbers = np.arange(len(frames))[:, None]
    for velocity in velocities:
        assert min(np.abs(one.path_pixels - numbers * velocity).max() for one in (found, *found.others)) < 0.6
