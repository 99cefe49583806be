"""What a scene needs to be modelled, what is left out and why, from its geometry alone."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from radiometry.errors import InputError
from radiometry.prediction import patches_of, predict
from radiometry.throughput import detector_to_pixel, light_budget
from sim.coherence import spectral_lines
from sim.detector_roughness import oversampling
from sim.effects import Effect, decide
from sim.geometry import Geometry
from sim.illumination import overlap, specular_share
from sim.object_samples import ObjectSamples, sample_object
from sim.propagation.choose import Option, choose, options
from sim.propagation.sampling import Scatterers

CAMERA_SECONDS_PER_PIXEL = 7e-8
"""Blur and Poisson draw of one frame per pixel on two cores; only a prediction of time, never a result."""


@dataclass(frozen=True)
class Settings:
    """What is asked of the propagation.

    Attributes:
        accuracy: what `tolerance` bounds: `statistical`, the expected autocorrelation; `field`, this realisation's field.
        propagator: a kernel's name, or `auto`.
        precision: `float32`, `float64`, or None for either.
        effects: (name, on) of effects that are forced.
    """

    accuracy: str = "statistical"
    tolerance: float = 1e-2
    propagator: str = "auto"
    precision: str | None = None
    effects: tuple[tuple[str, bool], ...] = ()


def check_sampling(geometry: Geometry) -> None:
    """The frame must sample the finest speckle fringes of the object: extent <= lambda z / (2 pitch)."""
    for extent, pitch in zip(geometry.hidden_object.extent_m, geometry.seen_pitch_m, strict=True):
        field_of_view = 0.5 * geometry.wavelength_m * geometry.distance_m / pitch
        if extent > field_of_view:
            nearest = 2.0 * extent * pitch / geometry.wavelength_m
            raise InputError("hidden_object", f"at most {field_of_view * 1e3:.3g} mm across at {geometry.distance_m:.3g} m with "
                             f"{pitch * 1e6:.3g} um pixels on the wall", f"{extent * 1e3:.3g} mm",
                             f"move the virtual detector to {nearest:.3g} m or more, or use smaller pixels")


def check_rough(geometry: Geometry) -> None:
    """An object smoother than about lambda / 4 keeps a specular part, which is not modelled."""
    height_rms_m = geometry.hidden_object.height_rms_m
    if 4.0 * math.pi * height_rms_m / geometry.wavelength_m < math.pi:
        raise InputError("height_rms", f"a rough hidden_object, {geometry.wavelength_m / 4.0:.3g} m or more", height_rms_m,
                         "the specular part of smooth objects is not modelled")


def check_exposure(geometry: Geometry) -> None:
    """Photoelectrons must fit the random generator and single precision."""
    electronics = geometry.electronics
    rate = light_budget(geometry.light_path).photoelectrons_per_pixel_s + electronics.dark_current
    if not rate * electronics.exposure_s < 1e12:
        raise InputError("exposure", "fewer than 1e12 electrons in a pixel", f"{rate * electronics.exposure_s:.3g}",
                         "lower exposure, power or dark_current")


def propagators(geometry: Geometry, samples: ObjectSamples, settings: Settings, *, cheapest: bool = False) -> list[Option]:
    """All kernels for a scene with their predicted errors and costs, cheapest first."""
    if len(samples.amplitude) == 0:
        return [Option("fraunhofer", "float32", 0.0, 0.0, 0, "nothing reflects")]
    bare = Scatterers(samples.position_m, samples.amplitude.astype(np.float64))
    pitches_m = patches_of(geometry)[1]
    stretch = geometry.hidden_object.axes.stretch
    return options(samples.wall, samples.flat_m, bare, (pitches_m[0] / stretch[0], pitches_m[1] / stretch[1]), settings.accuracy, settings.tolerance, settings.precision,
                   cheapest=cheapest)


def choose_propagator(geometry: Geometry, samples: ObjectSamples, settings: Settings) -> Option:
    """The kernel that a scene's frames are made with."""
    listed = propagators(geometry, samples, settings, cheapest=settings.propagator == "auto")
    return choose(listed, settings.propagator, settings.tolerance)


def check(geometry: Geometry) -> None:
    """Raise InputError where the scene cannot be modelled as `statistical` accuracy asks."""
    check_sampling(geometry)
    check_rough(geometry)
    check_exposure(geometry)


@dataclass(frozen=True)
class Modes:
    """What a frame sums over, each with a wall field of its own.

    Attributes:
        exact_roughness: whether the virtual detector's roughness is imaged, not drawn from its statistics.
        oversampling: samples of the field per pixel and axis, 1 but for exact roughness.
        polarisations: 1, or 2 where light is depolarised.
        lines: (offset in Hz, weight) of each spectral line.
    """

    exact_roughness: bool
    oversampling: int
    polarisations: int
    lines: tuple[tuple[float, float], ...]

    @property
    def samples(self) -> int:
        """Field samples for each pixel of a frame."""
        return self.oversampling**2 * self.polarisations * len(self.lines)


def modes_of(geometry: Geometry, samples: ObjectSamples, effects: dict[str, Effect], accuracy: str) -> Modes:
    """The modes that the effects of a scene ask for."""
    exact = effects["detector_roughness"].modelled and accuracy == "field"
    spread = effects["linewidth"].modelled and len(samples.path_m) > 0
    return Modes(exact, oversampling(geometry) if exact else 1, 2 if effects["depolarisation"].modelled else 1,
                 tuple(spectral_lines(samples.path_m, geometry.linewidth_hz)) if spread else ((0.0, 1.0),))


def make_plan(geometry: Geometry, frames: int, settings: Settings | None = None) -> dict[str, Any]:
    """The plan as JSON: kernels, effects, warnings, prediction of time and memory, light budget.

    Raises InputError where the scene cannot be modelled at all.
    """
    check(geometry)
    settings = settings or Settings()
    pixels = math.prod(geometry.frame_shape)
    samples = sample_object(geometry)
    kernels = propagators(geometry, samples, settings)
    kernel = choose(kernels, settings.propagator, settings.tolerance)
    prediction = predict(geometry)
    effects = decide(geometry, samples, prediction.terms, settings.effects, settings.tolerance)
    modes = modes_of(geometry, samples, effects, settings.accuracy)
    listed = [*effects.values(),
              Effect("direct_light", False, "blocked by a shape" if geometry.baffled else "not blocked by any shape", 0.0)]
    budget = light_budget(geometry.light_path)
    warnings = [f"{effect.name}: predicted error {effect.predicted_error:.2g} exceeds the tolerance "
                f"{settings.tolerance:g}" for effect in listed if effect.predicted_error > settings.tolerance]
    if kernel.predicted_error > settings.tolerance:
        warnings.insert(0, f"propagator {kernel.propagator}: predicted {settings.accuracy} error {kernel.predicted_error:.2g} "
                        f"exceeds the tolerance {settings.tolerance:g}; use --propagator auto")
    warnings += scene_warnings(geometry, prediction.pitches_m)
    return {
        "accuracy": settings.accuracy,
        "tolerance": settings.tolerance,
        "propagator": kernel.propagator,
        "precision": kernel.precision,
        "propagators": [option.as_dict() for option in kernels],
        "scatterers": len(samples.amplitude),
        "effects": [asdict(effect) for effect in listed],
        "predicted_error": kernel.predicted_error + math.fsum(effect.predicted_error for effect in listed),
        "warnings": warnings,
        "seconds": frames * modes.samples * (kernel.seconds + pixels * CAMERA_SECONDS_PER_PIXEL),
        "bytes": (kernel.bytes + 24 * pixels) * modes.oversampling**2,
        "frames": frames,
        "throughput": budget.as_dict(),
        "ideal_floor_over_peak": prediction.shot_floor_over_peak,
    }


def scene_warnings(geometry: Geometry, pitches_m: tuple[float, float]) -> list[str]:
    """What the scene holds that will not show as its author may think."""
    budget, electronics = light_budget(geometry.light_path), geometry.electronics
    warnings = []
    share = specular_share(geometry)
    if share > 1e-3:
        warnings.append(f"virtual_source: {100 * share:.3g} % of the light goes its mirror's way, past or onto the object; "
                        "the light budget counts all of it as scattered")
    common = overlap(geometry)
    if common > 0.0:
        warnings.append(f"scan_step: {100 * common:.3g} % of the spot is shared by one frame and the next, whose speckle then "
                        f"correlates by {common**2:.2g}: fewer degrees of freedom than predicted; move it by "
                        f"{geometry.spot.diameter_m:.3g} m or more")
    for width_m, pitch_m in zip(geometry.hidden_object.extent_m, pitches_m, strict=True):
        if width_m > 64 * pitch_m:
            warnings.append(f"hidden_object: {width_m * 1e3:.3g} mm across, but the 64 lags of {pitch_m * 1e6:.4g} um that "
                            f"truth.npy and invert hold end at {64e3 * pitch_m:.3g} mm; render a smaller one, or invert with "
                            "a smaller --patch")
    if budget.per_pixel == 0.0:
        warnings.append("hidden_object: none of its light reaches the camera; check its albedo, its facing, and occluders")
    if not geometry.baffled:
        per_frame = (geometry.direct_light * math.prod(geometry.frame_shape) * geometry.pixel_pitch_m**2
                     * detector_to_pixel(geometry.light_path) * budget.laser_photons_per_s)
        warnings.append("direct_light: nothing stands between virtual source and virtual detector; "
                        f"{per_frame:.3g} photoelectrons/s a frame come straight from the source (none if it faces away) "
                        "and are not modelled; add a baffle")
    mean = budget.photoelectrons_per_pixel_s * electronics.exposure_s
    # Speckle is negative-exponential: this share of the pixels lies above the full well.
    saturated = math.exp(-electronics.full_well / mean) if electronics.full_well and mean else 0.0
    if saturated > 1e-3:
        warnings.append(f"full_well: {100 * saturated:.3g} % of the pixels will saturate, "
                        "which the noise prediction leaves out")
    return warnings
