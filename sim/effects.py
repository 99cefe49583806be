"""Selection of the effects of a scene: an effect is modelled if its omission would exceed the tolerance, or if it is forced."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from correlograph.errors import InputError
from radiometry.coherence import variance_lost_to_linewidth
from radiometry.prediction import Prediction
from radiometry.sensor import chain
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import Stage
from sim.geometry import Geometry
from sim.laser_speckle import grain_m
from sim.optics.motion import variance_lost_to_motion
from sim.optics.object_samples import ObjectSamples
from sim.optics.other_light import StrayLight

OPTICAL = (
    "source_grain",
    "pupil_and_pixel",
    "detector_roughness",
    "detector_texture",
    "depolarisation",
    "linewidth",
    "ambient",
    "other_light",
    "motion",
)

FORCEABLE = (*OPTICAL, *(stage.name for stage in chain.CHAIN))
"""Effects that can be forced: of the light, and the stages of the sensor."""


@dataclass(frozen=True)
class Effect:
    """One line of the plan.

    Attributes:
        predicted_error: error that results if the effect is omitted, or from its model if it is modelled: a relative error
            of the expected autocorrelation, or a floor over peak for noise.
    """

    name: str
    modelled: bool
    why: str
    predicted_error: float


def parse_effects(texts: Iterable[str]) -> tuple[tuple[str, bool], ...]:
    """Parse `--effect NAME=on|off|auto` options into (name, on) of those that are not auto. Raises InputError for an unknown
    effect or value.
    """
    forced: dict[str, bool] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in FORCEABLE or value not in ("on", "off", "auto"):
            raise InputError("--effect", f"NAME=on|off|auto, NAME of {', '.join(FORCEABLE)}", text, "correct the value")
        if name in forced:
            raise InputError(f"--effect {name}", "one setting", "two", "give it once")
        if value != "auto":
            forced[name] = value == "on"
    return tuple(forced.items())


def decide(
    prediction: Prediction, samples: ObjectSamples, stray: StrayLight, forced: tuple[tuple[str, bool], ...], tolerance: float
) -> dict[str, Effect]:
    """Decide for each effect of a scene whether it is modelled, and why.

    Raises InputError if an effect is forced that needs a missing parameter of the scene.
    """
    geometry = prediction.geometry
    found = _optical_effects(prediction, samples, stray, tolerance)
    found += [_effect_of(stage, prediction) for stage in chain.CHAIN]
    decided = {effect.name: effect for effect in found}
    for name, is_on in forced:
        if is_on and _is_unset(name, decided[name], geometry):
            raise InputError(
                f"--effect {name}",
                "a parameter of the scene that sets it",
                "zero",
                f"set {_parameters().get(name, name)} in the scene",
            )
        why = f"forced {'on' if is_on else 'off'}; {decided[name].why}"
        decided[name] = replace(decided[name], modelled=is_on, why=why)
    remaining = {
        name: 0.0 if effect.modelled and name != "phase_screen" else effect.predicted_error for name, effect in decided.items()
    }
    return {name: replace(effect, predicted_error=remaining[name]) for name, effect in decided.items()}


def _is_unset(name: str, effect: Effect, geometry: Geometry) -> bool:
    """Return whether the scene gives no parameter for an effect."""
    if name in _parameters():
        return not getattr(geometry.camera.electronics, _parameters()[name])
    if name == "linewidth":
        return geometry.spot.linewidth_hz == 0.0
    if name == "ambient":
        return geometry.wall.ambient_irradiance is None
    return name in ("motion", "other_light", "detector_texture") and effect.predicted_error == 0.0


def _optical_effects(prediction: Prediction, samples: ObjectSamples, stray: StrayLight, tolerance: float) -> list[Effect]:
    """Return the effects of light before the electronics of the camera."""
    geometry, terms = prediction.geometry, prediction.terms
    source = geometry.spot
    phase_rms = 4.0 * math.pi * source.height_rms_m / geometry.wavelength_m
    scattering = phase_rms * geometry.wavelength_m / (2.0 * math.pi * source.correlation_length_m)
    half_angle = 0.5 * max(geometry.hidden_object.extent_m) / geometry.source_distance_m
    speckle = terms.over_peak()["detector_speckle"] or 0.0
    lit, texture = geometry.wall.ambient_irradiance is not None, geometry.wall.texture
    spread = 0.0 if texture is None else float(texture.std(dtype="f8"))
    moved = variance_lost_to_motion(geometry, samples)
    contrast = variance_lost_to_linewidth(*stray.joint_paths(samples), geometry.spot.linewidth_hz)
    background = geometry.other_light_share - stray.coherent_share
    return [
        Effect(
            "phase_screen",
            True,
            f"rough virtual source (phase rms {phase_rms:.3g} rad), independent samples",
            min(1.0, 0.5 * (half_angle / scattering) ** 2) if scattering else 0.0,
        ),
        Effect("source_grain", True, f"grain of {grain_m(geometry) * 1e6:.3g} um on the object", 0.0),
        Effect("pupil_and_pixel", True, "H, incoherent blur by pupil and pixel", 0.0),
        Effect(
            "detector_roughness", speckle > tolerance, "subjective speckle of the virtual detector, as floor over peak", speckle
        ),
        Effect(
            "detector_texture",
            spread > 0.0,
            f"albedo of the virtual detector, {spread:.3g} rms of its mean in the frame; its variance over the speckle's",
            spread**2,
        ),
        Effect(
            "depolarisation",
            geometry.is_depolarised,
            "a wall or the object is set to depolarise: two incoherent modes"
            if geometry.is_depolarised
            else "no phase_screen is set to depolarise",
            float(geometry.is_depolarised),
        ),
        Effect(
            "ambient",
            lit,
            f"{'other emitters' if lit else 'no emitter except the laser'}, as floor over peak",
            terms.over_peak()["ambient"] or 0.0,
        ),
        Effect(
            "other_light",
            geometry.other_light_share > tolerance,
            "the laser's light by way of clutter or of several reflections, over the hidden object's: "
            f"{stray.coherent_share:.2g} beats with it, {background:.2g} adds in intensity",
            geometry.other_light_share,
        ),
        Effect(
            "motion",
            moved > tolerance,
            "share of the speckle's variance that is lost while the shutter is open"
            if geometry.moves or geometry.motion.moves
            else "nothing moves while the shutter is open",
            moved,
        ),
        Effect("linewidth", contrast > tolerance, f"{geometry.spot.linewidth_hz:.3g} Hz against the spread of paths", contrast),
    ]


def remaining_electronics(electronics: Electronics, decided: dict[str, Effect]) -> Electronics:
    """Return the camera parameters without the omitted effects."""
    off = {parameter: 0 for name, parameter in _parameters().items() if not decided[name].modelled}
    if electronics.bits and "full_well" in off and not electronics.gain:
        off["bits"] = 0  # without the range of the ADC
    if off.get("bits") == 0:
        off["gain"] = 0.0
    return replace(electronics, **off)


def _effect_of(stage: Stage, prediction: Prediction) -> Effect:
    """Return the line of the plan for a stage of the sensor."""
    electronics = prediction.geometry.camera.electronics
    if not stage.is_set(electronics):
        return Effect(stage.name, False, f"the speckle_camera leaves {stage.parameter} at zero", 0.0)
    lines = prediction.line_noise_over_peak()
    share = lines.get(stage.name, prediction.terms.share(stage))
    value = getattr(electronics, stage.parameter)
    why = "the light is counted" if value is True else f"{stage.parameter} {value:g} {stage.unit}"
    if stage.name in lines:
        why += f", which adds {share:.2g} of the peak to the lags of one axis"
    elif share:
        why += f", which adds {share:.2g} to floor over peak"
    return Effect(stage.name, True, why, abs(share))


def _parameters() -> dict[str, str]:
    """Return the parameter of the speckle_camera that enables each stage."""
    return {stage.name: stage.parameter for stage in chain.CHAIN}
