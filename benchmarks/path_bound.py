"""`python -m benchmarks.path_bound`: Cramer-Rao bound of the paths of objects, also that of `benchmarks/tracking.py`.

The patterns are unknown Gaussian random fields; their powers, and how they fade, follow from the scene (the Fisher information is
that of `invert/tracking/normal_equations.py`). The illumination, of which no frame tells, stretches each path at random (this is a bound
with random parameters: Van Trees, Detection, Estimation, and Modulation Theory I, 2.4.3). Single paths may lie below it.

The command prints the bound of the last position of an object that moves uniformly: of a path of any form, and of one that is known to be
straight.
"""

from __future__ import annotations

import argparse

import numpy as np

import correlograph as cg
from correlograph.files.capture import Capture
from invert.tracking.band import Band
from invert.tracking.components import Components
from invert.tracking.normal_equations import NormalEquations
from invert.tracking.spectra import DIM_FRAMES_FOR_POWER, Reader
from invert.tracking.to_object import slope_variance
from sim.geometry import Geometry
from sim.optics.object_samples import ObjectSamples, sample_object
from sim.rendering import render_geometry
from sim.scene_file import parse_definitions

FRAMES_FOR_BAND = DIM_FRAMES_FOR_POWER
"""Number of frames from which the command takes the band of the speckle."""


def bounds_m(geometry: Geometry, capture: Capture, truths: list[np.ndarray]) -> list[float]:
    """Return the Cramer-Rao bound of the path of each object in metres, rms of both axes together, about its mean difference."""
    samples, to_metres, frames = sample_object(geometry), np.linalg.inv(geometry.travel), len(truths[0])
    covariance = np.zeros((frames, len(truths), 2, frames, len(truths), 2))  # of positions from the first
    information = information_of_frames(geometry, capture, truths)
    size = 2 * len(truths) * (frames - 1)
    covariance[1:, :, :, 1:] = np.linalg.inv(information.reshape(size, size)).reshape(information.shape)
    centred, bounds = np.eye(frames) - 1.0 / frames, []
    for number, truth in enumerate(truths):
        own = np.einsum("ia,tasb,ib->its", to_metres, covariance[:, number, :, :, number], to_metres)
        of_noise = np.einsum("ts,its->", centred, own) / frames
        bounds.append(float(np.sqrt(of_noise + stretch_variance(geometry, samples, number) * truth.var(0).sum())))
    return bounds


def information_of_frames(geometry: Geometry, capture: Capture, truths: list[np.ndarray]) -> np.ndarray:
    """Return the Fisher information of positions in frames with noise, per squared pixel, (T - 1, n, 2, T - 1, n, 2).

    It is that of n objects in T frames, from the second on. The band of the frames is that of a capture, which may have fewer.
    """
    band = Reader(capture.frames[0].shape, 1).band(capture.frames)
    assert band is not None
    paths, places = np.stack([truth @ geometry.travel.T for truth in truths]), np.argwhere(band.counts > 0.0)
    frames, components = paths.shape[1], components_of(geometry, sample_object(geometry), band, truths)
    normal = NormalEquations.of(np.zeros((frames, *band.signal.shape), np.complex64), band, components, places)
    return normal.information(paths, slice(0, frames))[1:, :, :, 1:] / band.noise_gain


def stretch_variance(geometry: Geometry, samples: ObjectSamples, number: int) -> float:
    """Return the variance of what the illumination stretches the path of an object by, both axes together, over its squared length."""
    mine = samples.part == number
    slope = slope_variance(samples.amplitude[mine] ** 2, samples.coordinates_m[mine], np.prod(geometry.object_pitch_m))
    lever = np.linalg.inv(geometry.travel) * geometry.wavelength_m * geometry.distance_m
    lever = lever / (2.0 * np.pi * np.array(geometry.seen_pitch_m))
    return float(np.trace(lever @ slope @ lever.T))


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
    scale = band.power / (together * band.counts).sum()
    powers = scale * np.stack([power(one) for one in spectra])
    steps = np.array([np.mean(np.diff(truth, axis=0) ** 2) * 2.0 for truth in truths])
    v_squared = steps * (np.pi * geometry.spot.diameter_m / (geometry.wavelength_m * geometry.source_distance_m)) ** 2
    return Components(powers, np.maximum(scale * together - powers.sum(0), 0.0) + band.floor, v_squared / 4.0)


def main() -> None:
    """Print the bound of the last position for a number of frames."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.path_bound", description=__doc__)
    parser.add_argument("scene", help="shipped scene or file with one object that moves uniformly")
    parser.add_argument("-D", dest="definitions", action="append", default=[], metavar="key=value", help="scene parameter")
    parser.add_argument("--frames", type=int, nargs="+", default=[32, 128], help="numbers of frames")
    options = parser.parse_args()
    geometry = cg.load(options.scene, **parse_definitions(options.definitions)).geometry
    capture = render_geometry(geometry, FRAMES_FOR_BAND)
    for frames in options.frames:
        truth = np.arange(frames)[:, None] * geometry.object_way_m
        way = float(np.linalg.norm(truth[-1] @ geometry.travel.T))
        information = information_of_frames(geometry, capture, [truth])[:, 0, :, :, 0]
        ramp = np.arange(1, frames) / (frames - 1.0)
        of_any_form = np.linalg.inv(information.reshape(2 * frames - 2, -1))[-2:, -2:]
        straight = np.linalg.inv(np.einsum("t,tasb,s->ab", ramp, information, ramp))
        free, known = (float(np.trace(one)) ** 0.5 for one in (of_any_form, straight))
        stretch = stretch_variance(geometry, sample_object(geometry), 0) ** 0.5
        print(
            f"{frames} frames, {way:.0f} pixels: noise {free:.1f} pixels ({free / way:.2%}), {known:.1f} ({known / way:.2%}) of a "
            f"straight path; illumination {stretch:.2%}"
        )


if __name__ == "__main__":
    main()
