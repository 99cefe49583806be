"""Light budget: laser, virtual source, object, virtual detector, pupil, pixel.

In the closed form every surface is Lambertian and small compared with its distance, so each reflection contributes a factor
albedo cos cos A / (pi d^2). Together they give P A_obj A_det A_pupil / (pi^3 d1^2 d2^2 d3^2) times cosines and losses (Metzler et
al. 2020, section 6.B). Only the pupil is not small; it contributes sin^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING

from correlograph.errors import InputError, check_positive
from radiometry.photons import decibel, photon_rate

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LightPath:
    """Input of the closed form. Lengths in metres, areas in m^2, angles as cosines, the rest ratios.

    `object_albedo_area_m2` is the integral of the albedo over the object's own surface.
    """

    wavelength_m: float
    power_w: float
    source_albedo: float
    source_cosine: float
    source_to_object_m: float
    object_cosine_in: float
    object_albedo_area_m2: float
    object_cosine_out: float
    object_to_detector_m: float
    detector_cosine_in: float
    detector_albedo: float
    detector_cosine_out: float
    detector_to_pupil_m: float
    pupil_diameter_m: float
    pupil_cosine: float
    transmission: float
    quantum_efficiency: float
    pixel_area_m2: float
    pixels: int
    beyond_flat: float = 1.0
    """Ratio of ray-traced to closed-form light; curvature, depth, tilt and non-Lambertian BSDFs make it differ from 1."""

    def __post_init__(self) -> None:
        for name in (
            "wavelength_m",
            "source_to_object_m",
            "object_to_detector_m",
            "detector_to_pupil_m",
            "pupil_diameter_m",
            "pixel_area_m2",
            "pixels",
            "beyond_flat",
        ):
            check_positive(name, getattr(self, name))
        for name in ("power_w", "object_albedo_area_m2"):
            check_positive(name, getattr(self, name), zero_allowed=True)
        for name in (
            "source_albedo",
            "source_cosine",
            "object_cosine_in",
            "object_cosine_out",
            "detector_cosine_in",
            "detector_albedo",
            "detector_cosine_out",
            "pupil_cosine",
            "transmission",
            "quantum_efficiency",
        ):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(name, "a ratio between 0 and 1", getattr(self, name), f"correct {name}")


@dataclass(frozen=True, repr=False)
class Budget:
    """Light budget of one pixel: named factors whose product is its throughput."""

    rows: tuple[tuple[str, float], ...]
    laser_photons_per_s: float
    pixels: int

    def __repr__(self) -> str:
        """The table that `python -m radiometry` prints."""
        rows = [*((name, decibel(factor)) for name, factor in self.rows), ("per pixel", self.per_pixel_db)]
        lines = [f"{name:<40}{value:9.2f} dB" for name, value in (*rows, ("per frame", self.per_frame_db))]
        return "\n".join([*lines, f"{'photoelectrons per second and frame':<40}{self.photoelectrons_per_frame_s:9.3g}"])

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"

    def plot(self) -> Figure:
        """Return the factors in decibels as a matplotlib figure."""
        from matplotlib.figure import Figure

        shown = [(name, decibel(factor)) for name, factor in self.rows if 0.0 < factor != 1.0]
        figure = Figure(figsize=(6.4, 0.6 + 0.28 * len(shown)), layout="constrained")
        axes = figure.add_subplot()
        axes.barh([name for name, _ in shown][::-1], [value for _, value in shown][::-1], color="0.5")
        axes.set_xlabel(f"factor (dB); together {self.per_pixel_db:.2f} dB per pixel")
        return figure

    @property
    def per_pixel(self) -> float:
        """Photoelectrons in one pixel per laser photon."""
        return math.prod(factor for _, factor in self.rows)

    @property
    def per_pixel_db(self) -> float:
        return math.fsum(decibel(factor) for _, factor in self.rows)

    @property
    def per_frame_db(self) -> float:
        return self.per_pixel_db + decibel(self.pixels)

    @property
    def photoelectrons_per_pixel_s(self) -> float:
        return self.laser_photons_per_s * self.per_pixel

    @property
    def photoelectrons_per_frame_s(self) -> float:
        return self.photoelectrons_per_pixel_s * self.pixels

    def as_dict(self) -> dict[str, object]:
        """Return the budget for JSON: `per_pixel_db`, `per_frame_db`, `photoelectrons_per_frame_s`, `rows`; null if no light
        arrives.
        """

        def finite(value: float) -> float | None:
            return value if math.isfinite(value) else None

        return {
            "per_pixel_db": finite(self.per_pixel_db),
            "per_frame_db": finite(self.per_frame_db),
            "photoelectrons_per_frame_s": self.photoelectrons_per_frame_s,
            "photons_per_second": self.photoelectrons_per_frame_s,  # old name
            "rows": [{"name": name, "db": finite(decibel(factor))} for name, factor in self.rows],
        }


def pupil_fraction(diameter_m: float, distance_m: float) -> float:
    """Return the fraction of a Lambertian wall's light that falls on a disc facing it: sin^2 of the half angle.

    A / (pi d^2) for a small pupil, 1 for a pupil that receives everything.
    """
    radius = 0.5 * diameter_m
    return radius**2 / (radius**2 + distance_m**2)


def light_budget(path: LightPath) -> Budget:
    """Return the light budget of one pixel, on which frames are based: the rows of the closed form, and one row for the
    ratio of the traced light to the closed form.
    """
    flat = closed_form(path)
    return replace(flat, rows=(*flat.rows, ("shape and BSDFs, beyond flat and Lambertian", path.beyond_flat)))


def closed_form(path: LightPath) -> Budget:
    """Return the light budget of one pixel for flat, small, Lambertian surfaces, one row per physical factor."""
    rows = (
        ("virtual source albedo", path.source_albedo),
        ("virtual source cosine", path.source_cosine),
        ("virtual source to object", path.object_albedo_area_m2 / (math.pi * path.source_to_object_m**2)),
        ("object cosine, incoming", path.object_cosine_in),
        ("object cosine, outgoing", path.object_cosine_out),
        ("object to pixel on virtual detector", path.pixel_area_m2 / (math.pi * path.object_to_detector_m**2)),
        ("virtual detector cosine, incoming", path.detector_cosine_in),
        ("virtual detector albedo", path.detector_albedo),
        ("virtual detector cosine, outgoing", path.detector_cosine_out),
        ("virtual detector to pupil", pupil_fraction(path.pupil_diameter_m, path.detector_to_pupil_m)),
        ("pupil cosine", path.pupil_cosine),
        ("camera transmission", path.transmission),
        ("quantum efficiency", path.quantum_efficiency),
    )
    return Budget(rows, photon_rate(path.power_w, path.wavelength_m), path.pixels)


def detector_to_pixel(path: LightPath) -> float:
    """Return the photoelectrons per photon that lands on a pixel's footprint on the virtual detector."""
    return (
        path.detector_albedo
        * path.detector_cosine_out
        * path.pupil_cosine
        * path.transmission
        * path.quantum_efficiency
        * pupil_fraction(path.pupil_diameter_m, path.detector_to_pupil_m)
    )
