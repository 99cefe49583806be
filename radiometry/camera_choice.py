"""Comparison of cameras for a scene, over magnification, binning, pupil, wavelength and laser power.

Each combination replaces the camera of the scene, in the same place. Its frames are predicted as those of the scene are, and the
exposures follow at which the object is detected and at which its reconstruction reaches a correlation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tqdm import tqdm

from correlograph.errors import InputError
from radiometry.cameras import Camera
from radiometry.prediction import Prediction, predict


@dataclass(frozen=True)
class Arrangement:
    """Magnification, binning, pupil, wavelength and laser power with which a camera is used; None keeps the value of the
    scene.
    """

    magnification: float
    binning: int = 1
    pupil_diameter_m: float | None = None
    wavelength_m: float | None = None
    power_w: float | None = None

    def apply(self, geometry: Any, camera: Camera) -> Any:
        """Return the geometry of a scene with a camera in this arrangement."""
        if self.power_w is not None:
            geometry = geometry.with_power(self.power_w)
        if self.wavelength_m is not None:
            geometry = geometry.with_wavelength(self.wavelength_m)
        camera = camera.bin_pixels(self.binning)
        electronics = replace(
            geometry.camera.electronics,
            quantum_efficiency=camera.efficiency(geometry.wavelength_m),
            read_noise=camera.read_noise,
            dark_current=camera.dark_current,
            full_well=camera.full_well,
            row_noise=0.0,
            column_noise=0.0,
            fixed_pattern=0.0,
            bits=0,
            gain=0.0,
            gate=0.0,
        )
        return geometry.with_camera(
            pixel_pitch_m=camera.pixel_m / self.magnification,
            frame_shape=camera.shape,
            pupil_diameter_m=self.pupil_diameter_m or geometry.camera.pupil_diameter_m,
            electronics=electronics,
        )


@dataclass(frozen=True)
class CameraPlan:
    """Prediction for one camera in one arrangement.

    Attributes:
        photoelectrons: mean photoelectrons per pixel and frame from the object, at the exposure time of the scene.
        floor_over_peak, dof: noise of an estimate from the frames at the exposure of the scene.
        lag_pitch_m: lag pitch on the object in metres.
        field_m: part of the wall that the camera sees (rows, columns).
        detection_s: exposure of all frames together at which the object is detected; None if no exposure suffices.
        correlation_s: total exposure at which the error of the estimate is small enough for the required correlation; None
            also if no error is required.
        saturated: expected fraction of saturated pixels of a frame if the longer of these total exposures is divided among
            the frames.
        fields_s: total exposure at which the field of each frame can be retrieved; None if no exposure suffices.
        cells_m: width of the cells of the fields on the object (rows, columns); None with `fields_s`.
    """

    camera: str
    arrangement: Arrangement
    photoelectrons: float
    floor_over_peak: float
    dof: float
    lag_pitch_m: float
    field_m: tuple[float, float]
    detection_s: float | None
    correlation_s: float | None
    saturated: float
    fields_s: float | None = None
    cells_m: tuple[float, float] | None = None

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key: the shortest exposure for the required correlation first, then the shortest for detection; None comes
        last.
        """
        return tuple(math.inf if seconds is None else seconds for seconds in (self.correlation_s, self.detection_s))


def arrangements(
    magnifications: Iterable[float],
    binnings: Iterable[int] = (1,),
    pupils_m: Iterable[float | None] = (None,),
    wavelengths_m: Iterable[float | None] = (None,),
    powers_w: Iterable[float | None] = (None,),
) -> list[Arrangement]:
    """Return every combination of magnification, binning, pupil, wavelength and power; None keeps the value of the scene."""
    return [Arrangement(*values) for values in itertools.product(magnifications, binnings, pupils_m, wavelengths_m, powers_w)]


def compare_cameras(
    geometry: Any,
    cameras: Sequence[Camera],
    choices: Sequence[Arrangement],
    check: Callable[[Any], None],
    frames: int = 2,
    required_error: Callable[[Any, Prediction], float] | None = None,
) -> tuple[list[CameraPlan], list[str]]:
    """Predict every camera in every arrangement.

    Args:
        geometry: geometry of the scene.
        check: raises InputError for a geometry that cannot be modelled, as `sim.plan.check` does.
        frames: number of frames; the total exposure is divided equally among them.
        required_error: called with the geometry and the prediction of a camera; returns the relative error of an estimate that its
            reconstruction needs. None for detection only.

    Returns:
        the plans, best first, and one line for each combination that is impossible.
    """
    plans, impossible = [], []
    pairs = list(itertools.product(cameras, choices))
    for camera, choice in tqdm(pairs, desc="cameras", unit="camera", disable=None, leave=False):
        try:
            plans.append(_predict_one(geometry, camera, choice, check, frames, required_error))
        except InputError as error:
            binned = f", {choice.binning} x {choice.binning} binned" if choice.binning > 1 else ""
            impossible.append(f"{camera.name} at magnification {choice.magnification:g}{binned}: {error}")
    return sorted(plans, key=lambda plan: plan.rank), impossible


def _predict_one(
    geometry: Any,
    camera: Camera,
    choice: Arrangement,
    check: Callable[[Any], None],
    frames: int,
    required_error: Callable[[Any, Prediction], float] | None,
) -> CameraPlan:
    other = choice.apply(geometry, camera)
    check(other)
    prediction = predict(other)
    floor = prediction.floor_over_peak(frames)
    if floor is None:
        raise InputError("scene", "light from the hidden object", "none", "raise power or albedo")

    detection_s = prediction.detection_exposure_s(frames)
    correlation_s = None if required_error is None else prediction.error_exposure_s(frames, required_error(other, prediction))
    fields_s = prediction.fields_exposure_s()
    longest_s = max((one for one in (detection_s, correlation_s) if one is not None), default=0.0)
    mean = prediction.at_exposure(longest_s).terms.mean if longest_s else 0.0
    full_well = other.camera.electronics.full_well
    rows, columns = (side * other.camera.pixel_pitch_m for side in other.camera.frame_shape)
    return CameraPlan(
        camera.name,
        choice,
        prediction.terms.light.signal,
        floor,
        prediction.dof(frames),
        prediction.pitch_m,
        (rows, columns),
        *(None if one is None else one * frames for one in (detection_s, correlation_s)),
        # Speckle of one polarisation has an exponential histogram.
        math.exp(-full_well / mean) if full_well and mean > 0.0 else 0.0,
        None if fields_s is None else fields_s * frames,
        None if (forecast := prediction.forecast_light(frames)) is None else forecast.cells_m,
    )
