"""Plan of a scene: decided once, followed by the simulation, recorded in `sim.json`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from correlograph.errors import InputError
from correlograph.ranges import SI
from radiometry.coherence import spectral_lines
from radiometry.light_budget_rows import light_budget
from radiometry.prediction import Prediction, patches_of, predict
from sim.effects import FORCEABLE, Effect, decide
from sim.geometry import Geometry
from sim.optics.detector_roughness import oversampling
from sim.optics.motion import beats_remain, sub_exposures, typical_positions
from sim.optics.object_samples import ObjectSamples, sample_object
from sim.optics.other_light import StrayLight, stray_light_of
from sim.propagation.choose import choose, options
from sim.propagation.kernels import KERNELS
from sim.propagation.option import PRECISIONS, Option, Precision, Task
from sim.propagation.sampling import Scatterers


@dataclass(frozen=True)
class Settings:
    """Settings of the propagation.

    Attributes:
        accuracy: quantity that `tolerance` bounds: `statistical`, the expected autocorrelation; `field`, the field of this
            realisation.
        propagator: name of a propagator, or `auto`.
        precision: `float32`, `float64`, or None for either.
        effects: (name, on) of effects that are forced.
    """

    accuracy: str = "statistical"
    tolerance: float = 1e-2
    propagator: str = "auto"
    precision: Precision | None = None
    effects: tuple[tuple[str, bool], ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError for a value that `python -m sim` refuses, too."""
        for name, value, names in (
            ("accuracy", self.accuracy, ("statistical", "field")),
            ("propagator", self.propagator, ("auto", *KERNELS)),
            ("precision", self.precision, (None, *PRECISIONS)),
        ):
            if not (value is None or isinstance(value, str)) or value not in names:
                raise InputError(name, f"one of {', '.join(map(str, names))}", f"{value!r:.40}", "select one of these")
        SI.check("tolerance", self.tolerance)
        is_pairs = isinstance(self.effects, tuple) and all(isinstance(pair, tuple) and len(pair) == 2 for pair in self.effects)
        if not is_pairs or any(name not in FORCEABLE or not isinstance(on, bool) for name, on in self.effects):
            expected = f"pairs (name, True or False), names of {', '.join(FORCEABLE)}"
            raise InputError("effects", expected, f"{self.effects!r:.60}", "correct the pairs")


STATIC = -1
"""Index of light by things at rest among `Modes.objects`."""


@dataclass(frozen=True)
class Modes:
    """Modes of a frame, which add incoherently; each has its own field on the wall.

    Attributes:
        exact_roughness: whether the roughness of the virtual detector is imaged, not sampled from its statistics.
        oversampling: samples of the field per pixel and axis; 1 except for exact roughness.
        polarisations: 1, or 2 for depolarised light.
        lines: (offset in Hz, weight) of each spectral line.
        sub_exposures: number per frame.
        objects: indices of hidden objects that move differently and no longer interfere, and `STATIC` for stray light at rest; None
            where all light interferes.
    """

    exact_roughness: bool
    oversampling: int
    polarisations: int
    lines: tuple[tuple[float, float], ...]
    sub_exposures: int
    objects: tuple[int | None, ...] = (None,)

    @property
    def samples(self) -> int:
        """Field samples per pixel of a frame."""
        return self.oversampling**2 * self.polarisations * len(self.lines) * self.sub_exposures * len(self.objects)


@dataclass(frozen=True, repr=False)
class Plan:
    """All decisions about a scene.

    Attributes:
        samples: the sampled object, from which light is propagated.
        stray: stray laser light, as far as the effect `other_light` is modelled.
        kernels: propagators that were considered, fastest first; `kernel` is the selected one.
        effects: effects by name, modelled or omitted.
    """

    geometry: Geometry
    settings: Settings
    samples: ObjectSamples
    stray: StrayLight
    kernels: tuple[Option, ...]
    kernel: Option
    prediction: Prediction
    effects: dict[str, Effect]
    modes: Modes

    @classmethod
    def of(cls, geometry: Geometry, settings: Settings | None = None) -> Plan:
        """Plan a simulation. Raises InputError if the scene cannot be modelled with these settings."""
        settings = settings or Settings()
        check(geometry)
        samples = sample_object(geometry)
        kernels = _kernels(geometry, samples, settings)
        kernel = choose(kernels, settings.propagator, settings.tolerance)
        prediction = predict(geometry)
        stray = stray_light_of(geometry, samples, settings.tolerance)
        effects = decide(prediction, samples, stray, settings.effects, settings.tolerance)
        modes = _modes(geometry, samples, stray, effects, settings)
        return cls(geometry, settings, samples, stray, tuple(kernels), kernel, prediction, effects, modes)

    def with_geometry(self, geometry: Geometry) -> Plan:
        """Plan the same scene at another exposure or laser power; samples and propagators are reused."""
        check_exposure(geometry)
        prediction = replace(self.prediction, geometry=geometry)
        effects = decide(prediction, self.samples, self.stray, self.settings.effects, self.settings.tolerance)
        modes = _modes(geometry, self.samples, self.stray, effects, self.settings)
        return replace(self, geometry=geometry, prediction=prediction, effects=effects, modes=modes)

    @cached_property
    def mean_photoelectrons(self) -> float:
        """Expected photoelectrons of one pixel from the hidden object, over all speckle realisations."""
        return light_budget(self.geometry.light_path).photoelectrons_per_pixel_s * self.geometry.camera.electronics.exposure_s


def check(geometry: Geometry) -> None:
    """Raise InputError if the scene cannot be modelled at `statistical` accuracy."""
    check_sampling(geometry)
    check_rough(geometry)
    check_exposure(geometry)


def check_sampling(geometry: Geometry) -> None:
    """Check that the frame samples the finest speckle fringes of the object: object extent <= lambda z / (2 x pixel pitch on
    the wall).
    """
    for extent, pitch in zip(geometry.hidden_object.extent_m, geometry.seen_pitch_m, strict=True):
        field_of_view = 0.5 * geometry.wavelength_m * geometry.distance_m / pitch
        if extent > field_of_view:
            nearest = 2.0 * extent * pitch / geometry.wavelength_m
            raise InputError(
                "hidden_object",
                f"at most {field_of_view * 1e3:.3g} mm across at {geometry.distance_m:.3g} m "
                f"with {pitch * 1e6:.3g} um pixels on the wall",
                f"{extent * 1e3:.3g} mm",
                f"move the virtual detector to {nearest:.3g} m or more, or use smaller pixels",
            )


def check_rough(geometry: Geometry) -> None:
    """Refuse an object smoother than about lambda / 4, because its specular reflection is not modelled."""
    height_rms_m = geometry.hidden_object.height_rms_m
    if 4.0 * math.pi * height_rms_m / geometry.wavelength_m < math.pi:
        raise InputError(
            "height_rms",
            f"a rough hidden_object, {geometry.wavelength_m / 4.0:.3g} m or more",
            height_rms_m,
            "the specular part of smooth objects is not modelled",
        )


def check_exposure(geometry: Geometry) -> None:
    """Check that the number of photoelectrons is within the range of the Poisson generator and of single precision."""
    electronics = geometry.camera.electronics
    rate = light_budget(geometry.light_path).photoelectrons_per_pixel_s * (1.0 + geometry.other_light_share)
    rate += electronics.dark_current
    if not rate * electronics.exposure_s < 1e12:
        raise InputError(
            "exposure",
            "fewer than 1e12 electrons in a pixel",
            f"{rate * electronics.exposure_s:.3g}",
            "lower exposure, power or dark_current",
        )


def _kernels(geometry: Geometry, samples: ObjectSamples, settings: Settings) -> list[Option]:
    """Return the propagators for a scene with predicted errors and costs, fastest first, without those that cannot be
    chosen.
    """
    if len(samples.amplitude) == 0:
        return [Option("fraunhofer", "float32", 0.0, 0.0, 0, "nothing reflects")]
    bare = Scatterers(typical_positions(geometry, samples), samples.amplitude.astype(np.float64))
    pitches_m, stretch = patches_of(geometry)[1], geometry.hidden_object.axes.stretch
    lag_m = (pitches_m[0] / stretch[0], pitches_m[1] / stretch[1])
    precisions = PRECISIONS if settings.precision is None else (settings.precision,)
    return options(
        Task(
            samples.wall,
            samples.flat_m,
            bare,
            lag_m,
            settings.accuracy,
            settings.tolerance,
            precisions,
            leaves_lattice=not geometry.moves_on_lattice,
        ),
        settings.propagator,
    )


def _modes(
    geometry: Geometry, samples: ObjectSamples, stray: StrayLight, effects: dict[str, Effect], settings: Settings
) -> Modes:
    """Return the modes that the effects of a scene require."""
    exact = effects["detector_roughness"].modelled and settings.accuracy == "field"
    spread = effects["linewidth"].modelled and len(samples.path_m) > 0
    path_m = stray.joint_paths(samples)[0] if effects["other_light"].modelled else samples.path_m
    objects: tuple[int | None, ...] = (None,)
    static = effects["other_light"].modelled and stray.coherent is not None
    if ("motion", False) not in settings.effects and not beats_remain(geometry, samples, static=static):
        objects = (*map(int, np.unique(samples.part)), *([STATIC] if static else []))
    return Modes(
        exact,
        oversampling(geometry) if exact else 1,
        2 if effects["depolarisation"].modelled else 1,
        tuple(spectral_lines(path_m, geometry.spot.linewidth_hz)) if spread else ((0.0, 1.0),),
        sub_exposures(geometry, samples, settings.tolerance) if effects["motion"].modelled else 1,
        objects,
    )
