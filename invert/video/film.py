"""A film of an object: albedos with times, and its files."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.files.figures import add_scale_bar, figure_as_html
from correlograph.files.manifest import claim
from correlograph.files.output import atomic, output_folder, save_array
from invert.tracking.tables import save_table
from invert.tracking.track import Track
from invert.video.pooling import spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILM_FILES = ("film.gif", "film.png", "film.csv", "film.json", "film.npy")

SHEET_IMAGES = 12
"""Number of images on the contact sheet."""

MIN_FRAME_MS, MAX_FRAME_MS = 20, 655_350
"""Duration of a picture of a GIF: what viewers show, and what the format can hold."""

FILM_S = 4.0
"""Duration of a film whose frames have no times."""


@dataclass(frozen=True)
class Film:
    """Albedos of an object over time.

    Attributes:
        albedos: (images, n, n), float32.
        middle_frame: number of the frame at whose time each image is, (images,), with frames that are missing.
        confidence: predicted correlation of each image with the truth, (images,).
        frames_per_image: number of frames whose mean would have the noise of an image, on average.
        angle_deg: angle of the object in each image from the first frame, (images,); None if no rotation is followed.
        path: path of its speckle; None if the laser moves, or if the object stays where it is.
        pitches_m: pitch of the pixels along rows and columns; None if the camera is unknown.
        interval_s: time between frames; None if unknown.
        notes: corrections and choices made for the frames.
    """

    albedos: np.ndarray
    middle_frame: np.ndarray
    confidence: np.ndarray
    frames_per_image: int
    angle_deg: np.ndarray | None = None
    path: Track | None = None
    pitches_m: tuple[float, float] | None = None
    interval_s: float | None = None
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"Film({len(self.albedos)} images with the noise of {self.frames_per_image} frames each, "
            f"confidence {self.confidence.min():.2f} to {self.confidence.max():.2f})"
        )

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def title(self, number: int) -> str:
        """Return time and confidence of an image."""
        frame = self.middle_frame[number]
        when = f"frame {frame:.0f}" if self.interval_s is None else f"{frame * self.interval_s:.3g} s"
        return f"{when}, confidence {self.confidence[number]:.2f}"

    def plot(self) -> Figure:
        """Return some images, equally spaced in time, as a matplotlib figure."""
        from matplotlib.figure import Figure

        chosen = spread(len(self.albedos), SHEET_IMAGES)
        columns = min(len(chosen), 4)
        rows = -(-len(chosen) // columns)
        figure = Figure(figsize=(2.6 * columns, 2.8 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in panels:
            axes.set_axis_off()
        for axes, number in zip(panels, chosen, strict=False):
            self._draw(axes, int(number))
        return figure

    def _draw(self, axes: Any, number: int) -> None:
        albedo = self.albedos[number]
        axes.imshow(albedo, cmap="gray", vmin=0.0, vmax=max(float(self.albedos.max()), 1e-9))
        axes.set_title(self.title(number), fontsize=8)
        if self.pitches_m is not None:
            add_scale_bar(axes, self.pitches_m[1], *albedo.shape[::-1])

    def _draw_path(self, axes: Any, number: int) -> None:
        """Draw the path of the speckle over the wall, and where it is in an image."""
        assert self.path is not None
        table, path = self.columns(), self.path.path_pixels
        axes.plot(path[:, 1], path[:, 0], color="0.6", linewidth=0.8)
        axes.plot(table["column_pixels"][number], table["row_pixels"][number], "o", color="black")
        axes.set(xlabel="columns (pixels)", ylabel="rows (pixels)", aspect="equal")
        axes.set_title("path of the speckle", fontsize=8)
        axes.set_adjustable("datalim")
        axes.invert_yaxis()

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON, without the lists of the table."""
        return {
            "images": len(self.albedos),
            "frames_per_image": self.frames_per_image,
            "interval_s": self.interval_s,
            "pitches_m": None if self.pitches_m is None else list(self.pitches_m),
            "confidence_min": float(self.confidence.min()),
            "confidence_max": float(self.confidence.max()),
            "turn_deg": None if self.angle_deg is None else float(self.angle_deg[-1] - self.angle_deg[0]),
            "track": None if self.path is None else self.path.as_dict(),
            "notes": list(self.notes),
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of the table: frame, seconds if known, confidence, angle and place of the speckle where they are known."""
        table = {"frame": self.middle_frame}
        if self.interval_s is not None:
            table["time_s"] = self.middle_frame * self.interval_s
        table["confidence"] = self.confidence
        if self.angle_deg is not None:
            table["angle_deg"] = self.angle_deg
        if self.path is not None:
            for axis, values in zip(("row_pixels", "column_pixels"), self.path.path_pixels.T, strict=True):
                table[axis] = np.interp(self.middle_frame, self.path.frame_numbers, values, left=np.nan)  # before the path
        return table

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write film.gif, film.png (contact sheet), film.csv, film.json and film.npy (albedos); return the folder.

        Args:
            overwrite: whether to replace files of these names that this program did not write.
        """
        claim(output_folder(str(folder)), FILM_FILES, overwrite=overwrite)
        return save_table(folder, FILM_FILES, (self.columns(), self.as_dict(), self.plot()), self._save_images)

    def _save_images(self, folder: Path) -> None:
        save_array(folder / "film.npy", self.albedos)
        self._save_gif(folder / "film.gif")

    def _save_gif(self, path: Path) -> None:
        """Write the film in real time, if times are known and it lasts longer than a second."""
        from matplotlib.figure import Figure
        from PIL import Image

        pictures = []
        panels = 1 if self.path is None else 2
        for number in range(len(self.albedos)):
            figure = Figure(figsize=(3.2 * panels, 3.4), layout="constrained")
            left, *right = figure.subplots(1, panels, squeeze=False)[0]
            left.set_axis_off()
            self._draw(left, number)
            for axes in right:
                self._draw_path(axes, number)
            stream = io.BytesIO()
            figure.savefig(stream, format="png", dpi=100)
            pictures.append(Image.open(stream).convert("L"))
        lasts_s = FILM_S if self.interval_s is None else float(np.ptp(self.middle_frame)) * self.interval_s
        each_ms = min(max(MIN_FRAME_MS, round(1000.0 * max(lasts_s, 1.0) / len(pictures))), MAX_FRAME_MS)
        with atomic(path) as partial:
            pictures[0].save(partial, format="GIF", save_all=True, append_images=pictures[1:], duration=each_ms, loop=0)
