"""Characters as albedo bitmaps or solid meshes for scenes: `python -m data_gen.letters FOLDER F 7 R [--mesh-depth-m D]`.

DejaVu Sans (the font in matplotlib) on a 1 cm square of 256 x 256 cells, 8-bit, white is albedo 1. Strokes are thinned or
thickened to a reflective area of 0.2 cm^2, as in the figures of Metzler et al. 2020.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.files.manifest import claim
from correlograph.files.output import atomic, output_folder
from correlograph.ranges import Range
from data_gen.fonts import dejavu_sans

BITMAP_SIDE = 256
FILL = 0.2


def letter(character: str) -> np.ndarray:
    """Return the binary bitmap of a character, uint8 (256, 256), as high or wide as the square."""
    font = dejavu_sans(1000)
    canvas = Image.new("L", (2000, 2000))
    ImageDraw.Draw(canvas).text((500, 400), character, fill=255, font=font)
    ink = np.asarray(canvas) >= 128
    inside = distance_transform_edt(ink) - distance_transform_edt(~ink)
    low, high = -100.0, float(inside.max())
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _on_square(inside > middle).mean() > FILL * 255 else (low, middle)
    return _on_square(inside > low)


def _on_square(ink: np.ndarray) -> np.ndarray:
    """Crop to the character and scale it to fill the square, binary 0 or 255."""
    glyph = Image.fromarray(ink.astype(np.uint8) * 255)
    glyph = glyph.crop(glyph.getbbox())
    scale = BITMAP_SIDE / max(glyph.size)
    glyph = glyph.resize((round(glyph.width * scale), round(glyph.height * scale)), Image.Resampling.BILINEAR)
    square = Image.new("L", (BITMAP_SIDE, BITMAP_SIDE))
    square.paste(glyph, ((BITMAP_SIDE - glyph.width) // 2, (BITMAP_SIDE - glyph.height) // 2))
    return np.where(np.asarray(square) >= 128, 255, 0).astype(np.uint8)


MAX_LAYERS = 256
"""Maximum number of layers of triangles along the depth of a solid letter."""


def save_mesh(path: Path, bitmap: np.ndarray, depth_m: float, cells: int = 64) -> None:
    """Write a bitmap as a solid to a binary PLY file: 1 cm high, columns along x, rows along y, from z = -`depth_m` to the
    front at z = 0.
    """
    import trimesh
    from skimage.measure import marching_cubes

    coarse = bitmap.reshape(cells, BITMAP_SIDE // cells, cells, BITMAP_SIDE // cells).mean((1, 3)) / 255.0
    layers = min(max(2, round(depth_m * cells / 0.01)), MAX_LAYERS)
    solid = np.pad(np.repeat(coarse[..., None], layers, axis=2), 1)
    corner, face, _, _ = marching_cubes(solid, 0.5)
    row, column, layer = corner.T - 0.5
    place = np.stack([column, row, np.zeros_like(row)], 1) * (0.01 / cells) - [0.005, 0.005, 0.0]
    place[:, 2] = (np.clip(layer, 0.0, layers) / layers - 1.0) * depth_m
    mesh = trimesh.Trimesh(place, face, process=True)
    if mesh.volume < 0.0:
        mesh.invert()
    with atomic(path) as partial:
        partial.write_bytes(mesh.export(file_type="ply", vertex_normal=False))


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m data_gen.letters", description="Draw characters as albedo bitmaps.")
    p.add_argument("folder")
    p.add_argument("characters", nargs="+", help="one character each")
    p.add_argument("--mesh-depth-m", type=Range(1e-6, 1e3), help="write solid letters of this depth, G.ply, instead of bitmaps")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    options = parser().parse_args(argv)
    for character in options.characters:
        if len(character) != 1 or not character.isalnum():
            raise InputError("characters", "single letters or digits", character, "separate them by blanks")
    folder = output_folder(options.folder)
    kind = "png" if options.mesh_depth_m is None else "ply"
    claim(folder, [f"{character}.{kind}" for character in options.characters], overwrite=options.overwrite)
    for character in options.characters:
        bitmap = letter(character)
        if options.mesh_depth_m is not None:
            save_mesh(folder / f"{character}.ply", bitmap, options.mesh_depth_m)
            print(f"{character}.ply: {options.mesh_depth_m:g} m deep")
            continue
        with atomic(folder / f"{character}.png") as partial:
            Image.fromarray(bitmap).save(partial, format="PNG", optimize=True)
        print(f"{character}.png: reflective area {bitmap.mean() / 255:.3f} cm^2 on a 1 cm square")


if __name__ == "__main__":
    run_command(main)
