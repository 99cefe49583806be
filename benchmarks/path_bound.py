"""Cramer-Rao bound of the paths of objects (`benchmarks/tracking.py`).

It is that of frames whose patterns are known (Knapp and Carter, doi:10.1109/TASSP.1976.1162830), while the illumination, of which no frame
tells, is random (a bound with random parameters: Van Trees, Detection, Estimation, and Modulation Theory I, 2.4.3). On average, no tracker
reaches it, because the patterns are measured; single paths may lie below.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from correlograph.files.capture import Capture
from invert.tracking.shifts import weight_of
from invert.tracking.spectra import Reader
from invert.tracking.to_object import slope_variance
from sim.geometry import Geometry
from sim.optics.object_samples import sample_object


def bounds_m(geometry: Geometry, capture: Capture, truths: list[np.ndarray]) -> list[float]:
    """Return the Cramer-Rao bound of the path of each object in metres, rms of both axes together, about its mean difference.

    The speckle of an object with a share p of the light has the share p^2 of its power; the rest, the interference of all, is noise. The
    illumination stretches each path at random (`invert/tracking/to_object.py`), by the albedo of the scene.
    """
    band = Reader(capture.frames[0].shape, 1).band(capture.frames)
    assert band is not None
    samples, to_metres = sample_object(geometry), np.linalg.inv(geometry.travel)
    power = samples.amplitude**2
    light = np.array([power[samples.part == number].sum() for number in range(len(truths))]) / power.sum()
    turns = [2.0 * np.pi * band.rows[:, None], 2.0 * np.pi * band.columns[None]]
    bounds = []
    for number, (share, truth) in enumerate(zip(light, truths, strict=True)):
        noise = band.floor + (1.0 - (light**2).sum()) * band.signal
        weight = weight_of(replace(band, signal=share**2 * band.signal, floor=noise), 1.0, 10**6)
        curvature = np.array([[(weight.values * share**2 * band.signal * 1e6 * a * b).sum() for a in turns] for b in turns])
        inverse = np.linalg.inv(curvature)
        of_pattern = to_metres @ inverse @ (weight.slope_variance / band.noise_gain) @ inverse @ to_metres.T
        mine = samples.part == number
        slope = slope_variance(power[mine], samples.coordinates_m[mine], np.prod(geometry.object_pitch_m))
        moved = to_metres**2 @ (
            slope * (geometry.wavelength_m * geometry.distance_m / (2.0 * np.pi * np.array(geometry.seen_pitch_m))) ** 2
        )
        bounds.append(float(np.sqrt(np.trace(of_pattern) + moved.sum() * truth.var(0).sum())))
    return bounds
