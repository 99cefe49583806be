"""Laser safety of the spot, which limits the power: IEC 60825-1, visible continuous wave."""

from __future__ import annotations

import math

from correlograph.errors import InputError, check_positive

AVERSION_S = 0.25
"""Time after which the eye turns away from visible light."""


def maximum_permissible_exposure(wavelength_m: float, duration_s: float = AVERSION_S) -> float:
    """Return the corneal irradiance limit in W/m^2 for a point source, 400-700 nm, 18 us to 10 s (where the editions agree).

    18 t^0.75 J/m^2 with C6 = 1, divided by t. Raises InputError outside this range.
    """
    if not 400e-9 <= wavelength_m <= 700e-9:
        raise InputError(
            "wavelength",
            "400 to 700 nm (visible) for the laser-safety line",
            f"{wavelength_m * 1e9:.4g} nm",
            "look the limit up in IEC 60825-1",
        )
    if not 18e-6 <= duration_s <= 10.0:
        raise InputError("duration", "18 us to 10 s", duration_s, "use another value")
    return 18.0 * duration_s**0.75 / duration_s


def spot_safety(power_w: float, wavelength_m: float, spot_diameter_m: float, albedo: float = 1.0) -> dict[str, float]:
    """Return the irradiance of the spot in units of the limit, and the safe distance of an eye from the diffusely lit spot.

    `hazard_distance_m` is the distance at which the light of a Lambertian wall, P albedo / (pi d^2) on its normal, falls to the
    limit. If `spot_over_limit`, the irradiance of the spot over the limit, exceeds one, the direct beam is unsafe at the wall.
    """
    limit = maximum_permissible_exposure(wavelength_m)
    area = 0.25 * math.pi * check_positive("spot_diameter", spot_diameter_m) ** 2
    irradiance = check_positive("power", power_w, zero_allowed=True) / area
    return {
        "limit_w_per_m2": limit,
        "spot_w_per_m2": irradiance,
        "spot_over_limit": irradiance / limit,
        "hazard_distance_m": math.sqrt(power_w * albedo / (math.pi * limit)),
    }
