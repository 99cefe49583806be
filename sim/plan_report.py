"""Reports of a plan: JSON for `sim.json`, a page of text, warnings."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from html import escape
from typing import Any

import numpy as np

from correlograph.ranges import FRAMES
from radiometry.light_budget_rows import light_budget
from radiometry.noise.detection import DETECTION_LIMIT
from radiometry.prediction import predict
from sim.effects import Effect
from sim.geometry import Geometry
from sim.light_paths import describe, light_paths
from sim.plan import Plan, Settings
from sim.scene_warnings import MAX_STRAY_SHARE, camera_warnings, scene_warnings
from sim.transport.monte_carlo import MonteCarlo

CAMERA_SECONDS_PER_PIXEL = 7e-8
"""Duration of blur and Poisson sampling per pixel on two cores; it predicts times only."""

DISAGREEMENT = 0.02
"""Maximum relative difference between light budget and Monte Carlo without a warning, in addition to four standard errors."""

MAX_NAMED_SHAPES = 3

MAX_LINE_SHARE = 0.1
"""Noise of rows or columns over the peak, at the lags of one axis, above which a warning is given."""


class PlanPage(Plan):
    """A plan that prints as the page of `python -m sim --plan`, for two frames."""

    def __repr__(self) -> str:
        return summary(self, 2)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"


def make_plan(geometry: Geometry, frames: int, settings: Settings | None = None) -> dict[str, Any]:
    """Return the plan of a scene as JSON. Raises InputError if the scene cannot be modelled."""
    return as_json(Plan.of(geometry, settings), frames)


def as_json(plan: Plan, frames: int, monte_carlo: MonteCarlo | None = None) -> dict[str, Any]:
    """Return propagators, effects, warnings, predicted time and memory, and light budget for JSON."""
    geometry, kernel, modes = plan.geometry, plan.kernel, plan.modes
    pixels = math.prod(geometry.canvas_shape)
    listed = [
        *plan.effects.values(),
        Effect(
            "direct_light", False, "blocked by a shape" if geometry.is_direct_path_blocked else "not blocked by any shape", 0.0
        ),
        Effect(
            "defocus",
            False,
            "the sensor is taken to be tilted until all of the wall is in focus (Scheimpflug); "
            f"untilted, the frame's corner would be blurred over {defocus_pixels(geometry):.2g} pixels",
            0.0,
        ),
    ]
    return {
        "accuracy": plan.settings.accuracy,
        "tolerance": plan.settings.tolerance,
        "propagator": kernel.propagator,
        "precision": kernel.precision,
        "propagators": [option.as_dict() for option in plan.kernels],
        "scatterers": len(plan.samples.amplitude),
        "period_pixels": list(geometry.period_shape),
        "effects": [asdict(effect) for effect in listed],
        "predicted_error": kernel.predicted_error + math.fsum(effect.predicted_error for effect in listed),
        "warnings": warnings_of(plan, frames, monte_carlo),
        "seconds": frames * modes.samples * (kernel.seconds + pixels * CAMERA_SECONDS_PER_PIXEL),
        "bytes": (kernel.bytes + 24 * pixels) * modes.oversampling**2,
        "frames": frames,
        "throughput": light_budget(geometry.light_path).as_dict(),
        "monte_carlo": monte_carlo and monte_carlo.as_dict(),
        "grain_pixels": list(grain_pixels(geometry)),
        "patch_pixels": list(plan.prediction.grid.patch_shape),
        "lag_pitches_m": list(plan.prediction.pitches_m),
        "dof": plan.prediction.dof(frames),
        "floor_over_peak": plan.prediction.floor_over_peak(frames),
        "third_moment_signal_to_noise": plan.prediction.third_moment_signal_to_noise(frames),
        "ideal_floor_over_peak": plan.prediction.shot_floor_over_peak,
        "signal_to_noise": plan.prediction.signal_to_noise(frames),
        "fields": (forecast := plan.prediction.forecast_fields(frames)) and forecast.as_dict(),
        "detection_exposure_s": plan.prediction.detection_exposure_s(frames),
        "other_light_share": geometry.other_light_share,
        "light_paths": [asdict(path) for path in light_paths(plan)],
        "other_light_by_shape": dict(geometry.other_light.fractions) if geometry.other_light else {},
    }


def warnings_of(plan: Plan, frames: int, monte_carlo: MonteCarlo | None = None) -> list[str]:
    """Return warnings about properties that the author of a scene may not expect."""
    tolerance, kernel = plan.settings.tolerance, plan.kernel
    found = [
        f"{effect.name}: predicted error {effect.predicted_error:.2g} exceeds the tolerance {tolerance:g}"
        for effect in plan.effects.values()
        if effect.predicted_error > tolerance
    ]
    if kernel.predicted_error > tolerance:
        found.insert(
            0,
            f"propagator {kernel.propagator}: predicted {plan.settings.accuracy} error "
            f"{kernel.predicted_error:.2g} exceeds the tolerance {tolerance:g}; use --propagator auto",
        )
    found += scene_warnings(plan.geometry, plan.prediction.pitches_m) + camera_warnings(plan.prediction)
    if plan.geometry.other_light_share > MAX_STRAY_SHARE:
        found.append(stray_light_warning(plan, frames))
    found += [
        f"{name}: adds {share:.2g} of the peak to the lags of one axis, which a reconstruction takes for signal; lower {name}"
        for name, share in plan.prediction.line_noise_over_peak().items()
        if share > MAX_LINE_SHARE
    ]
    if monte_carlo is not None:
        found += disagreement(plan.geometry, monte_carlo)
    ratio = plan.prediction.signal_to_noise(frames)
    if ratio is not None and ratio < 1.0:
        found.append(
            f"signal to noise: {ratio:.2g} on average over the object's lags in {frames} frames; needed: "
            + required_exposure(plan, frames)
        )
    return found


def grain_pixels(geometry: Geometry) -> tuple[float, float]:
    """Return the speckle grain (rows, columns) in pixels, lambda z over the extent of the object."""
    rows, columns = (
        geometry.wavelength_m * geometry.distance_m / (extent * pitch)
        for extent, pitch in zip(geometry.hidden_object.extent_m, geometry.seen_pitch_m, strict=True)
    )
    return rows, columns


def defocus_pixels(geometry: Geometry) -> float:
    """Return the diameter, in pixels, of the blur in the corner of the frame if the sensor were not tilted to bring the
    whole wall into focus (Scheimpflug).
    """
    height, width = (0.5 * n * geometry.camera.pixel_pitch_m for n in geometry.camera.frame_shape)
    corner = max(
        float(np.linalg.norm(height * geometry.camera.down + side * width * geometry.camera.right)) for side in (-1.0, 1.0)
    )
    nearer = corner * math.sqrt(1.0 - geometry.light_path.detector_cosine_out**2)
    return nearer * geometry.camera.pupil_diameter_m / geometry.camera.pupil_distance_m / geometry.camera.pixel_pitch_m


def disagreement(geometry: Geometry, monte_carlo: MonteCarlo) -> list[str]:
    """Return a warning if light budget and Monte Carlo differ by more than four standard errors plus `DISAGREEMENT`."""
    budget = light_budget(geometry.light_path)
    expected = budget.per_pixel * budget.pixels
    allowed = 4.0 * monte_carlo.standard_error + DISAGREEMENT * max(expected, monte_carlo.per_frame)
    if abs(expected - monte_carlo.per_frame) <= allowed or expected == monte_carlo.per_frame:
        return []
    return [
        f"light budget: {budget.per_frame_db:.2f} dB per frame, but {monte_carlo.per_frame_db:.2f} dB by Monte Carlo (95 %: "
        + " to ".join("dark" if db is None else f"{db:.2f}" for db in monte_carlo.as_dict()["interval_db"])
        + "); surfaces or highlights may be finer than the sampling"
    ]


def required_exposure(plan: Plan, frames: int) -> str:
    """Return text that names a longer exposure of each frame or, alternatively, a larger number of frames at which the
    object becomes detectable.
    """
    exposure_s, expected = plan.geometry.camera.electronics.exposure_s, plan.prediction.detection(frames)
    if expected <= 0.0:
        return "light from the object"
    longer_s = plan.prediction.detection_exposure_s(frames)
    # K, and with it the square of the significance, is proportional to the number of frames.
    count = math.ceil(frames * (DETECTION_LIMIT / expected) ** 2)
    if count > FRAMES.most:
        return f"{frames} frames of {longer_s:.2g} s" if longer_s is not None else f"more than {FRAMES.most} frames; add light"
    by_exposure = "" if longer_s is None else f"{frames} frames of {longer_s:.2g} s, or "
    return f"{by_exposure}{count} of {exposure_s:g} s to detect the object"


def stray_light_warning(plan: Plan, frames: int) -> str:
    """Return a warning that names the sources of stray light, its cost in exposure and a remedy."""
    geometry = plan.geometry
    shapes = list(geometry.other_light.fractions.items())[:MAX_NAMED_SHAPES] if geometry.other_light else []
    named = ", ".join(f"{100.0 * fraction:.0f} % by {name}" for name, fraction in shapes)
    grid = plan.prediction.grid
    without = predict(replace(geometry, other_light=None), grid.size, grid.lags)
    seconds = [known.detection_exposure_s(frames) for known in (plan.prediction, without)]
    cost = "; detection takes {:.2g} s per frame, {:.2g} s without it".format(*seconds) if None not in seconds else ""
    return (
        f"other_light: stray light is {geometry.other_light_share:.3g} times the light of the object ({named}), and a "
        f"reconstruction shows its sources as well{cost}; darken, cover or move these shapes"
    )


def summary(plan: Plan, frames: int, monte_carlo: MonteCarlo | None = None) -> str:
    """Return the plan as one page of text."""
    geometry, prediction, kernel = plan.geometry, plan.prediction, plan.kernel
    content = as_json(plan, frames, monte_carlo)
    grid, pitches = prediction.grid, prediction.pitches_m
    grain = grain_pixels(geometry)
    dof, ratio, third = content["dof"], content["signal_to_noise"], content["third_moment_signal_to_noise"]
    floor, budget = prediction.floor_over_peak(frames), light_budget(geometry.light_path)
    forecast = prediction.forecast_fields(frames)
    lines = [
        "{} x {} pixels, ".format(*geometry.camera.frame_shape)
        + f"{frames} frames of {geometry.camera.electronics.exposure_s:g} s",
        f"light           {plan.mean_photoelectrons:.3g} photoelectrons per pixel; {budget.per_pixel_db:.2f} dB per pixel, "
        f"{budget.per_frame_db:.2f} dB per frame"
        + ("" if monte_carlo is None else f" ({monte_carlo.per_frame_db:.2f} dB by Monte Carlo)"),
        f"light paths     {describe(light_paths(plan))}",
        f"grain           {grain[0]:.1f} x {grain[1]:.1f} pixels",
        f"estimate        {grid.rows} x {grid.columns} patches of {grid.patch_shape[0]} x {grid.patch_shape[1]} pixels, "
        f"{pitches[0] * 1e6:.0f} x {pitches[1] * 1e6:.0f} um per lag, K {dof:.3g}",
        f"noise           floor over peak {'none' if floor is None else f'{floor:.3g}'}, signal to noise "
        f"{'none' if ratio is None else f'{ratio:.2g}'}, of the third moment {'none' if third is None else f'{third:.2g}'}",
        f"needed          {required_exposure(plan, frames)}",
        f"fields          {forecast.describe() if forecast else 'no light'}",
        f"propagation     {kernel.propagator} in {kernel.precision}, {plan.settings.accuracy} error "
        f"{kernel.predicted_error:.2g} of {plan.settings.tolerance:g} allowed, {content['scatterers']} scatterers, about "
        f"{content['seconds']:.1f} s",
        "modelled        " + ", ".join(name for name, effect in plan.effects.items() if effect.modelled),
        "omitted         "
        + ", ".join(
            f"{name} ({effect.predicted_error:.1g})" if effect.predicted_error else name
            for name, effect in plan.effects.items()
            if not effect.modelled
        )
        + f", defocus ({defocus_pixels(geometry):.2g} pixels if the sensor is not tilted with the wall)",
    ]
    return "\n".join(lines + [f"warning: {warning}" for warning in content["warnings"]])
