"""Warnings about parts of a scene that do not appear, or are not predicted, as expected."""

from __future__ import annotations

from radiometry.light_budget_rows import light_budget
from radiometry.prediction import Prediction
from radiometry.sensor.saturation import counting_fraction, saturated_fraction
from sim.foreseen import speckle_travels
from sim.geometry import Geometry
from sim.light_paths import direct_light_per_frame
from sim.optics.illumination import lost_over_spot, overlap, specular_part, specular_share

MIN_OBJECT_LAGS = 4.0
"""Lags across an object below which no shape can be seen."""

MAX_STRAY_SHARE = 0.3
"""Ratio of stray light to object light above which a warning is given; the stray light's r*r is then a tenth of the object's."""

MAX_LOST_OVER_SPOT = 0.01
"""Part of the squared contrast that path differences across the laser spot take, above which a warning is given."""

MAX_SPECULAR = 1e-3
"""Part of the light that a wall reflects like a mirror above which a warning is given."""

WITHIN_A_GRAIN = "a grain of its speckle is larger than the frame"
"""Finding about an object so small or so far away that no frame shows it."""

MAX_SATURATED, MAX_COUNTING = 1e-3, 0.9
"""Fraction of the pixels that saturate, and of the gates that count a photon, above which a warning is given."""


def scene_warnings(geometry: Geometry, pitches_m: tuple[float, float]) -> list[str]:
    """Return warnings about parts of a scene that will not appear as expected."""
    budget = light_budget(geometry.light_path)
    warnings = []
    share = specular_share(geometry)
    if share > MAX_SPECULAR:
        warnings.append(
            f"virtual_source: {100 * share:.3g} % of the light is specular and misses or meets the object; "
            "the light budget counts all of it as scattered"
        )
    common = overlap(geometry)
    # With a laser at rest, a moving object is tracked by the speckle that its frames share.
    if common > 0.0 and not (geometry.spot.scan_step_m == 0.0 and speckle_travels(geometry)):
        warnings.append(
            f"scan_step: {100 * common:.3g} % of the spot is common to consecutive frames, whose speckle then "
            f"correlates by {common**2:.2g}, with fewer degrees of freedom than predicted; move it by "
            f"{geometry.spot.diameter_m:.3g} m or more"
        )
    if common > 0.0 and geometry.spot.scan_step_m and geometry.other_light_share > MAX_STRAY_SHARE:
        warnings.append(
            "other_light: stray light of spots that overlap is drawn as if they did not; move the spot by its diameter"
        )
    spread_m, lost = lost_over_spot(geometry)
    if lost > MAX_LOST_OVER_SPOT:
        warnings.append(
            f"linewidth: the ways of the light differ by {1e3 * spread_m:.3g} mm across the laser spot, which lowers contrast^2 by "
            f"{100.0 * lost:.2g} %; frames and predictions leave this out; use a narrower line, a smaller spot, or an upright beam"
        )
    for width_m, pitch_m in zip(geometry.hidden_object.extent_m, pitches_m, strict=True):
        if width_m > 64 * pitch_m:
            warnings.append(
                f"hidden_object: {width_m * 1e3:.3g} mm across, but the 64 lags of {pitch_m * 1e6:.4g} um that "
                f"truth.npy and invert hold end at {64e3 * pitch_m:.3g} mm; render a smaller one, or invert with "
                "a smaller --patch"
            )
        if width_m < MIN_OBJECT_LAGS * pitch_m:
            warnings.append(
                f"hidden_object: {width_m * 1e3:.3g} mm across, {width_m / pitch_m:.2g} lags of {pitch_m * 1e6:.4g} um, too few to "
                "show its shape; enlarge it, come closer or photograph more of the wall"
            )
    if geometry.is_within_a_grain:
        warnings.append(f"hidden_object: {WITHIN_A_GRAIN}; the predicted noise does not hold, and no frame is rendered")
    wall = geometry.wall.height_rms_m
    if wall is not None and (share := specular_part(wall, geometry.wavelength_m)) > MAX_SPECULAR:
        warnings.append(
            f"virtual_detector: {100 * share:.3g} % of the light is specular; frames and light budget count all of it as scattered"
        )
    if geometry.blur_pixels > min(geometry.camera.frame_shape):
        warnings.append(
            f"pupil_diameter: the camera blurs by {geometry.blur_pixels:.3g} pixels, more than a side of the frame; frames lack the light "
            "from farther away, so that their contrast is too high"
        )
    if budget.per_pixel == 0.0:
        warnings.append("hidden_object: none of its light reaches the camera; check its albedo, its facing, and occluders")
    if geometry.direct_light > 0.0:
        per_frame = direct_light_per_frame(geometry) * budget.laser_photons_per_s
        warnings.append(
            "direct_light: no shape blocks the path from virtual source to virtual detector; "
            f"{per_frame:.3g} photoelectrons/s per frame arrive directly from the source "
            "and are not modelled; add a baffle"
        )
    return warnings


def camera_warnings(prediction: Prediction) -> list[str]:
    """Return warnings about pixels that no longer tell how much light they receive."""
    light, electronics = prediction.terms.light, prediction.geometry.camera.electronics
    warnings = []
    if (saturated := saturated_fraction(light, electronics)) > MAX_SATURATED:
        limit = "full_well" if electronics.ceiling + electronics.step >= electronics.full_well > 0.0 else "bits"
        warnings.append(f"{limit}: {100 * saturated:.3g} % of the pixels will saturate, which the noise prediction omits")
    if (counting := counting_fraction(light, electronics)) > MAX_COUNTING:
        warnings.append(
            f"gate: {100 * counting:.3g} % of the gates will count a photon, whatever the speckle; lower the light or the gate"
        )
    return warnings
