"""Cramer-Rao bound of the paths of objects (`benchmarks/tracking.py`).

The patterns are unknown Gaussian random fields; their powers, and how they fade, follow from the scene (the Fisher information is
that of `invert/tracking/normal_equations.py`). The illumination, of which no frame tells, stretches each path at random (this is a bound
with random parameters: Van Trees, Detection, Estimation, and Modulation Theory I, 2.4.3). Single paths may lie below it.
"""

from __future__ import annotations

import numpy as np

from correlograph.files.capture import Capture
from invert.tracking.band import Band
from invert.tracking.components import Components
from invert.tracking.normal_equations import NormalEquations
from invert.tracking.spectra import Reader
from invert.tracking.to_object import slope_variance
from sim.geometry import Geometry
from sim.optics.object_samples import ObjectSamples, sample_object


def bounds_m(geometry: Geometry, capture: Capture, truths: list[np.ndarray]) -> list[float]:
    """Return the Cramer-Rao bound of the path of each object in metres, rms of both axes together, about its mean difference."""
    band = Reader(capture.frames[0].shape, 1).band(capture.frames)
    assert band is not None
    samples, to_metres, count = sample_object(geometry), np.linalg.inv(geometry.travel), len(truths)
    paths = np.stack([truth @ geometry.travel.T for truth in truths])
    places, frames = np.argwhere(band.counts > 0.0), paths.shape[1]
    nothing = np.zeros((frames, *band.signal.shape), np.complex64)
    normal = NormalEquations.of(nothing, band, components_of(geometry, samples, band, truths), places)
    information = normal.information(paths, slice(0, frames)).reshape(2 * count * frames, -1)
    covariance = np.zeros_like(information)  # of positions from the first
    covariance[2 * count :, 2 * count :] = band.noise_gain * np.linalg.inv(information[2 * count :, 2 * count :])
    covariance = covariance.reshape(frames, count, 2, frames, count, 2)
    centred, bounds = np.eye(frames) - 1.0 / frames, []
    for number, truth in enumerate(truths):
        own = np.einsum("ia,tasb,ib->its", to_metres, covariance[:, number, :, :, number], to_metres)
        of_noise = np.einsum("ts,its->", centred, own) / frames
        mine = samples.part == number
        slope = slope_variance(samples.amplitude[mine] ** 2, samples.coordinates_m[mine], np.prod(geometry.object_pitch_m))
        lever = to_metres * geometry.wavelength_m * geometry.distance_m / (2.0 * np.pi * np.array(geometry.seen_pitch_m))
        bounds.append(float(np.sqrt(of_noise + np.trace(lever @ slope @ lever.T) * truth.var(0).sum())))
    return bounds


def components_of(geometry: Geometry, samples: ObjectSamples, band: Band, truths: list[np.ndarray]) -> Components:
    """Return the powers of the speckle of a scene in a band of its frames: autocorrelations of the light on the objects.

    The rest of that of all light together is interference.

    The illumination by a round spot of diameter D changes by exp(-v^2 / 4) over the way v lambda d1 / (pi D) (its transfer is 2 J1(v) / v).
    """
    cell_m = geometry.wavelength_m * geometry.distance_m / (np.array(geometry.seen_pitch_m) * band.shape)
    place = np.round((samples.coordinates_m - samples.coordinates_m.min(0)) / cell_m).astype(int)
    shape = tuple(2 * int(side) + 2 for side in place.max(0))
    spectra = []
    for number in range(len(truths)):
        light, mine = np.zeros(shape), samples.part == number
        np.add.at(light, tuple(place[mine].T), samples.amplitude[mine] ** 2)
        spectra.append(np.fft.fft2(light))

    def power(spectrum: np.ndarray) -> np.ndarray:
        rows, columns = (
            np.round(one * side).astype(int) for one, side in zip((band.rows, band.columns), band.shape, strict=True)
        )
        is_inside = (np.abs(rows)[:, None] < shape[0] // 2) & (np.abs(columns) < shape[1] // 2) & (band.counts > 0.0)
        lags = np.fft.ifft2(np.abs(spectrum) ** 2).real
        return np.where(is_inside, lags[np.ix_(rows % shape[0], columns % shape[1])], 0.0).clip(0.0)

    together = power(np.sum(spectra, 0))
    scale = (band.signal * band.counts).sum() / (together * band.counts).sum()
    powers = scale * np.stack([power(one) for one in spectra])
    steps = np.array([np.mean(np.diff(truth, axis=0) ** 2) * 2.0 for truth in truths])
    v_squared = steps * (np.pi * geometry.spot.diameter_m / (geometry.wavelength_m * geometry.source_distance_m)) ** 2
    return Components(powers, np.maximum(scale * together - powers.sum(0), 0.0) + band.floor, v_squared / 4.0)
