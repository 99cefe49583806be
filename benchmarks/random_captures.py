"""Captures of random scenes, objects, cameras and noise, for tests of the fields on data that chose no constant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import correlograph as cg
from benchmarks.pages import page
from data_gen.edges import find_photographs, read_luminance
from data_gen.letters import letter
from data_gen.shapes import filled_shape
from scenes import scene_path

SIDE = 512

WORDS = ("quick brown", "fox jumps", "over lazy", "dogs while", "zebras wait", "behind", "walls of", "jade", "and onyx")


def draw_object(rng: np.random.Generator, photographs: Path | None) -> tuple[str, np.ndarray]:
    """Return kind and bitmap (SIDE, SIDE), uint8, of an object."""
    kinds = ["letter", "page", "shape"] + (["grey"] if photographs is not None else [])
    kind = str(rng.choice(kinds))
    if kind == "letter":
        return kind, np.asarray(Image.fromarray(letter(str(rng.choice(list("AEGKQS24"))))).resize((SIDE, SIDE)))
    if kind == "page":
        return kind, _page(rng)
    outline = np.asarray(Image.fromarray(filled_shape(rng)).resize((SIDE, SIDE)))
    if kind == "shape":
        return kind, outline
    files = find_photographs(photographs)
    photograph = read_luminance(files.folder / str(rng.choice(files.names)))
    crop = np.asarray(Image.fromarray(photograph[:240, :240].astype(np.uint8)).resize((SIDE, SIDE)))
    return kind, np.where(outline > 127, crop, 0).astype(np.uint8)


def _page(rng: np.random.Generator) -> np.ndarray:
    lines = [str(rng.choice(WORDS)) for _ in range(int(rng.integers(2, 7)))]
    return np.asarray(Image.fromarray(page("\n".join(lines))).resize((SIDE, SIDE)))


def draw_scene(number: int, folder: Path, photographs: Path | None) -> tuple[dict[str, Any], cg.Scene, cg.Capture]:
    """Return the description of random capture `number`, its scene and the capture; bitmap and scene are written to the folder."""
    rng = np.random.default_rng([number, 11])
    base = str(
        rng.choice(
            ["corner_letter", "tilted_letter", "strong_ambient", "two_depths", "glyph_mesh"], p=[0.4, 0.2, 0.2, 0.1, 0.1]
        )
    )
    kind, bitmap = draw_object(rng, photographs)
    rows, columns = (int(side) for side in rng.integers(700, 2057, 2))
    drawn: dict[str, Any] = {
        "scene": base,
        "object": kind if base not in ("two_depths", "glyph_mesh") else base,
        "shape": [rows, columns],
        "frames": int(rng.choice([1, 2, 4, 10, 20], p=[0.2, 0.35, 0.25, 0.15, 0.05])),
        "exposure_s": float(2.0 ** rng.uniform(-4.0, 0.0)),
        "standoff_m": float(np.exp(rng.uniform(np.log(0.5), np.log(5.0)))) if base == "corner_letter" else 1.0,
        "pixel_pitch_um": float(rng.choice([2.4, 3.45, 5.5])),
        "read_noise": float(rng.choice([0.0, rng.uniform(0.0, 2.0)])),
        "bits": int(rng.choice([0, 8, 12, 16])),
        "is_depolarising": bool(rng.random() < 0.15),
        "is_rough": bool(rng.random() < 0.3),
        "accuracy": "field" if rng.random() < 0.33 else "statistical",
    }
    text = scene_path(base).read_text()
    camera = f'<float name="read_noise" value="{drawn["read_noise"]}"/>'
    if drawn["bits"]:
        camera += f'<integer name="bits" value="{drawn["bits"]}"/><float name="gain" value="{rng.uniform(0.05, 0.5)}"/>'
    camera += f'<float name="pixel_pitch" value="{drawn["pixel_pitch_um"] * 1e-6}"/>'
    text = text.replace('<float name="pixel_pitch" value="3.45e-6"/>', camera)
    text = text.replace('name="width" value="2464"', f'name="width" value="{columns}"')
    text = text.replace('name="height" value="2056"', f'name="height" value="{rows}"')
    if drawn["is_depolarising"]:
        head, tail = text.split('id="hidden_object', 1)
        screen = '<float name="height_rms" value="2e-6"/>'
        text = head + 'id="hidden_object' + tail.replace(screen, screen + '<boolean name="depolarising" value="true"/>')
    parameters: dict[str, Any] = {"exposure": drawn["exposure_s"]}
    if base in ("corner_letter", "tilted_letter", "strong_ambient"):
        Image.fromarray(bitmap).save(folder / f"object_{number}.png")
        parameters["albedo"] = str((folder / f"object_{number}.png").resolve())
    if base == "corner_letter":
        parameters |= {"standoff": drawn["standoff_m"], "power": 0.3 * drawn["standoff_m"] ** 2}
    if base == "tilted_letter":
        parameters["tilt"] = drawn["tilt_degrees"] = float(rng.uniform(0.0, 40.0))
    if base == "strong_ambient":
        parameters["radiance"] = float(rng.uniform(0.0, 1.5e-4))
    for asset in scene_path(base).parent.iterdir():
        if asset.suffix in (".png", ".ply"):
            text = text.replace(f'"{asset.name}"', f'"{asset}"')
    file = folder / f"scene_{number}.xml"
    file.write_text(text)
    scene = cg.load(str(file), **parameters)
    effects = (("detector_roughness", True),) if drawn["is_rough"] else ()
    settings = cg.Settings(accuracy=drawn["accuracy"], effects=effects)
    return drawn, scene, cg.render(scene, frames=drawn["frames"], seed=number, settings=settings)
