"""`Field`: the complex field on the object in each look, for further use. Unpolarised light has two looks per frame."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path

import numpy as np

from correlograph.errors import SI_MAX, InputError, check_positive
from correlograph.files.output import atomic, path_of


@dataclass(frozen=True)
class Field:
    """Field on the object in each look, in square roots of photoelectrons per cell.

    The global phase of each frame, a shift, and the twin image (complex conjugate, rotated by 180 degrees) are undetermined. The
    field includes the Fresnel phase of the distance between object and wall. Retrieved fields are posterior means:
    where the counts say little, they are smaller than the field itself.

    Attributes:
        samples: complex64 (looks, rows, columns).
        wall_shape: samples of the field on the wall (rows, columns) that is its Fourier transform.
        frame_shape: samples of the wall that the frame covers.
        pitches_m: width of a cell on the object along rows and columns; None if the camera is unknown.
        wavelength_m, distance_m: wavelength, and distance from the object to the wall, in metres.
    """

    samples: np.ndarray
    wall_shape: tuple[int, int]
    frame_shape: tuple[int, int]
    pitches_m: tuple[float, float] | None = None
    wavelength_m: float | None = None
    distance_m: float | None = None

    def __post_init__(self) -> None:
        """Raise InputError for anything else than finite complex samples of frames that fit on the wall."""
        found = f"{getattr(self.samples, 'dtype', type(self.samples).__name__)} {np.shape(self.samples)}"
        if not isinstance(self.samples, np.ndarray) or self.samples.dtype.kind != "c" or self.samples.ndim != 3:
            raise InputError("field", "complex samples (looks, rows, columns)", found, "provide such an array")
        if not np.isfinite(self.samples).all() or any(
            side > whole for side, whole in zip(self.samples.shape[1:], self.wall_shape, strict=True)
        ):
            raise InputError("field", "finite samples that fit on the wall", found, "provide such an array")

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        looks, rows, columns = self.samples.shape
        pitch = "unknown pitch" if self.pitches_m is None else f"cells of {self.pitches_m[0] * 1e6:.3g} um"
        return f"Field({looks} looks of {rows} x {columns} cells, {pitch})"

    @property
    def intensity(self) -> np.ndarray:
        """Mean squared modulus over the looks, float32 (rows, columns): the albedo times the illumination, less the posterior variance."""
        return (np.abs(self.samples) ** 2).mean(0)

    def on_wall(self) -> np.ndarray:
        """Return the field on the wall within the frame, complex64 (looks, rows, columns), up to the Fresnel phase on the wall."""
        wall = np.fft.fft2(self.samples, self.wall_shape, norm="ortho")
        return wall[:, : self.frame_shape[0], : self.frame_shape[1]].astype(np.complex64)

    def refocus(self, depth_m: float) -> Field:
        """Return the field in a plane that is farther from the wall by `depth_m`; the twin image has the opposite sign of the depth.

        A displacement multiplies the field on the wall by the phase pi x^2 (1 / distance - 1 / (distance + depth)) / wavelength.

        Raises InputError if the camera is unknown, or for a depth that is not a number or not small against the distance.
        """
        if self.pitches_m is None or self.wavelength_m is None or self.distance_m is None:
            raise InputError("field", "a known camera", "none", "provide the camera metadata with the frames")
        if not isinstance(depth_m, Real) or not abs(depth_m) < 0.1 * self.distance_m:
            expected = f"a number below a tenth of the distance ({self.distance_m:g} m)"
            raise InputError("depth_m", expected, f"{depth_m!r:.40}", "use a smaller depth")
        rows, columns = (
            (np.arange(count) - 0.5 * (covered - 1)) * (self.wavelength_m * self.distance_m / (count * pitch))
            for count, covered, pitch in zip(self.wall_shape, self.frame_shape, self.pitches_m, strict=True)
        )
        farther_m = self.distance_m * (self.distance_m + float(depth_m))
        phase = (np.pi * float(depth_m) / (self.wavelength_m * farther_m)) * (rows[:, None] ** 2 + columns[None] ** 2)
        height, width = self.samples.shape[1:]
        centre = [(count - covered) // 2 for count, covered in zip(self.wall_shape, (height, width), strict=True)]
        room = np.zeros((len(self), *self.wall_shape), np.complex64)
        room[:, centre[0] : centre[0] + height, centre[1] : centre[1] + width] = self.samples
        moved = np.fft.ifft2(np.fft.fft2(room) * np.exp(1j * phase))
        kept = moved[:, centre[0] : centre[0] + height, centre[1] : centre[1] + width]
        return replace(self, samples=kept.astype(np.complex64))

    def combine(self, other: Field) -> Field:
        """Return the looks of two fields on the same cells. Raises InputError for other cells."""
        if not isinstance(other, Field) or (self.samples.shape[1:], self.wall_shape, self.pitches_m) != (
            other.samples.shape[1:],
            other.wall_shape,
            other.pitches_m,
        ):
            raise InputError("other", "a field on the same cells", f"{other!r:.80}", "retrieve both with one call")
        return replace(self, samples=np.concatenate((self.samples, other.samples)))

    def save(self, path: str | Path) -> None:
        """Write the field as an NPZ file."""
        numbers = {
            "wall_shape": self.wall_shape,
            "frame_shape": self.frame_shape,
            "pitches_m": self.pitches_m or (),
            "wavelength_m": self.wavelength_m or (),
            "distance_m": self.distance_m or (),
        }
        with atomic(path_of("path", path)) as partial, partial.open("wb") as file:
            np.savez(file, samples=self.samples, **{name: np.asarray(value) for name, value in numbers.items()})

    @classmethod
    def load(cls, path: str | Path) -> Field:
        """Read a field. Raises InputError for other files."""
        file = path_of("path", path)
        try:
            with np.load(file, allow_pickle=False) as content:
                shapes = [tuple(int(side) for side in content[name]) for name in ("wall_shape", "frame_shape")]
                pitches = tuple(check_positive("pitches_m", float(pitch)) for pitch in content["pitches_m"])
                lengths = [_length(name, content[name]) for name in ("wavelength_m", "distance_m")]
                if any(len(shape) != 2 or not 0 < min(shape) <= max(shape) < SI_MAX for shape in shapes) or len(
                    pitches
                ) not in (0, 2):
                    raise ValueError("shapes or pitches")
                return cls(content["samples"], *shapes, pitches or None, *lengths)
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
            found = f"{type(error).__name__} in {file} ({error!s:.80})"
            raise InputError("path", "a file fields.npz", found, "check the path") from None


def _length(name: str, value: np.ndarray) -> float | None:
    return check_positive(name, float(value)) if value.size else None
