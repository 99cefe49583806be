"""Table of cameras: `cameras.csv` with typical values of data sheets, or a user's own file with the same columns."""

from __future__ import annotations

import csv
from argparse import ArgumentTypeError
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.ranges import Range

TABLE = Path(__file__).with_name("cameras.csv")

NUMBERS = {
    "pixel_um": Range(0.01, 1e6),
    "columns": Range(1, 2**20),
    "rows": Range(1, 2**20),
    "read_noise_e": Range(0.0, 1e6),
    "dark_current_e_per_s": Range(0.0, 1e9),
    "full_well_e": Range(0.0, 1e12),
}
"""Columns of numbers and their ranges; `full_well_e` 0 stands for none."""

EFFICIENCY = "efficiency_"
"""Beginning of the columns of the quantum efficiency; the wavelength in nanometres follows."""


@dataclass(frozen=True)
class Camera:
    """A camera. Electrons and seconds, per pixel.

    Attributes:
        pixel_m: pitch of the pixels on the sensor.
        shape: pixels (rows, columns).
        bins_charge: whether binning adds charge before it is read, so that one read noise serves all; otherwise it adds
            digital numbers after the readout, so that the read noise adds up.
        efficiencies: quantum efficiency by wavelength in metres, shortest first.
    """

    name: str
    pixel_m: float
    shape: tuple[int, int]
    read_noise: float
    dark_current: float
    full_well: float
    bins_charge: bool
    efficiencies: tuple[tuple[float, float], ...]

    def efficiency(self, wavelength_m: float) -> float:
        """Return the quantum efficiency at a wavelength, interpolated. Raises InputError outside the wavelengths of the table."""
        wavelengths, values = zip(*self.efficiencies, strict=True)
        if not wavelengths[0] * 0.999 <= wavelength_m <= wavelengths[-1] * 1.001:
            expected = (
                f"{wavelengths[0] * 1e9:.0f} to {wavelengths[-1] * 1e9:.0f} nm, for which the table of cameras has efficiencies"
            )
            found = f"{wavelength_m * 1e9:.4g} nm for {self.name}"
            raise InputError("wavelength", expected, found, "add a column such as efficiency_405 to a table of your own")
        return float(np.interp(wavelength_m, wavelengths, values))

    def bin_pixels(self, pixels: int) -> Camera:
        """Return the camera with `pixels` x `pixels` binned to one pixel."""
        area = pixels**2
        return Camera(
            self.name,
            self.pixel_m * pixels,
            (self.shape[0] // pixels, self.shape[1] // pixels),
            self.read_noise * (1 if self.bins_charge else pixels),
            self.dark_current * area,
            self.full_well * (1 if self.bins_charge else area),
            self.bins_charge,
            self.efficiencies,
        )


def read_cameras(path: Path = TABLE) -> list[Camera]:
    """Read a table of cameras (CSV with a header). Raises InputError for a missing file, column or value."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError("--cameras", "a readable table of cameras (CSV)", f"{path} ({problem})", "check the file") from None
    reader = csv.DictReader(text.splitlines())
    columns = [name.strip() for name in reader.fieldnames or ()]
    missing = [name for name in ("name", *NUMBERS) if name not in columns]
    if not any(name.startswith(EFFICIENCY) for name in columns):
        missing.append(f"{EFFICIENCY}532 or another wavelength")
    if missing:
        raise InputError("--cameras", f"columns as in {TABLE.name}", f"no {', '.join(missing)} in {path}", "add the columns")
    cameras = [
        _camera(dict(zip(columns, row.values(), strict=False)), f"{path}, camera {n}") for n, row in enumerate(reader, 1)
    ]
    if not cameras:
        raise InputError("--cameras", "at least one camera", f"none in {path}", "add a line")
    return cameras


def _camera(row: Mapping[str, str | None], place: str) -> Camera:
    def number(column: str, allowed: Range) -> Any:
        text = (row[column] or "").strip()
        try:
            return allowed(text)
        except ArgumentTypeError:
            raise InputError(f"{column} ({place})", str(allowed), repr(text), "correct the table") from None

    values = {name: number(name, allowed) for name, allowed in NUMBERS.items()}
    efficiencies = []
    for column in row:
        if column.startswith(EFFICIENCY):
            try:
                nanometres = float(column.removeprefix(EFFICIENCY))
            except ValueError:
                raise InputError("--cameras", "columns such as efficiency_532", column, "rename the column") from None
            efficiencies.append((nanometres * 1e-9, number(column, Range(0.0, 1.0))))
    return Camera(
        (row["name"] or "").strip(),
        values["pixel_um"] * 1e-6,
        (values["rows"], values["columns"]),
        values["read_noise_e"],
        values["dark_current_e_per_s"],
        values["full_well_e"],
        (row.get("charge_binning") or "no").strip().lower() in ("yes", "true", "1"),
        tuple(sorted(efficiencies)),
    )
