"""`correlograph new-scene PICTURE -o FOLDER`: write a scene round a corner, with a picture as the hidden object, and its drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import SI_MAX, InputError
from correlograph.ranges import SI, Range
from scenes.corner import MAX_ANGLE_DEG, Corner

SCENE_FILES = ("scene.xml", "object.png", "scene.png")
SIDE = Range(1, 2**16)
ANGLE, ELECTRONS = Range(0.0, MAX_ANGLE_DEG), Range(0.0, SI_MAX)
RANGES = {
    "source_angle_deg": ANGLE,
    "camera_angle_deg": ANGLE,
    "wall_albedo": Range(0.0, 1.0),
    "read_noise": ELECTRONS,
    "full_well": ELECTRONS,
    "bits": Range(0, 32),
}

HELP = {
    "object_width_m": "width of the picture",
    "source_distance_m": "from the object to the wall that the laser lights",
    "source_angle_deg": "angle of that wall off the object's normal",
    "detector_distance_m": "from the object to the wall that the camera photographs",
    "camera_angle_deg": "angle of the camera off the normal of that wall",
    "pixel_pitch_m": "on the sensor",
    "magnification": "of the lens",
    "focal_length_m": "of the lens, which stands at f (1 + 1 / magnification) from the wall",
    "f_number": "of the lens",
    "wavelength_m": "of the laser",
    "power_w": "of the laser",
    "spot_diameter_m": "of the laser on the wall",
    "exposure_s": "of a frame",
    "wall_albedo": "reflectance of both walls",
    "read_noise": "electrons rms",
    "full_well": "electrons",
    "bits": "of the converter; needs --full-well",
}


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="correlograph new-scene", description="Write a scene round a corner. Lengths in metres.")
    p.add_argument("picture", type=Path, help="grey picture of the object; its brightest pixel has reflectance 1")
    p.add_argument("-o", "--output", required=True, help="folder for scene.xml, object.png and the drawing scene.png")
    p.add_argument("--pixels", nargs=2, type=SIDE, metavar=("WIDTH", "HEIGHT"), help="of the camera (2464 2056)")
    for one in fields(Corner):
        if one.name in HELP:
            kind = RANGES.get(one.name, SI)
            option = f"--{one.name.replace('_', '-')}"
            p.add_argument(option, type=kind, default=one.default, help=f"{HELP[one.name]} ({one.default:g})")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Check the numbers, write the scene, load it and draw it."""
    options = parser().parse_args(argv)
    values = {name: getattr(options, name) for name in HELP}
    if options.pixels is not None:
        values["frame_shape"] = (options.pixels[1], options.pixels[0])
    corner = Corner(**values)
    if not options.picture.is_file():
        raise InputError("picture", "a picture of the object", f"no {options.picture}", "check the path")
    from correlograph.progress import stage

    with stage("loading"):
        import sim
    import numpy as np
    from PIL import Image

    from correlograph.files.figures import save_figure
    from correlograph.files.images import read_image
    from correlograph.files.manifest import claim
    from correlograph.files.output import atomic, output_folder, replace_files, sole_writer, staging_folder

    pixels = read_image(options.picture)[0]
    folder = output_folder(options.output)
    claim(folder, SCENE_FILES, overwrite=options.overwrite)
    if not np.isfinite(pixels).all() or pixels.min() < 0.0 or pixels.max() == 0.0:
        found = f"{pixels.min():g} to {pixels.max():g}"
        raise InputError("picture", "finite grey levels, zero or more, and one that is brighter", found, "use another picture")
    with sole_writer(folder), staging_folder(folder) as staging:
        grey = (255.0 * pixels / pixels.max()).round().astype("uint8")
        with atomic(staging / "object.png") as partial:
            Image.fromarray(grey).save(partial, format="PNG")
        with atomic(staging / "scene.xml") as partial:
            partial.write_text(corner.as_xml("object.png", len(pixels) / len(pixels[0])), encoding="utf-8")
        with stage("planning"):
            scene = sim.load(staging / "scene.xml")
            page, scene.name = str(scene.plan()), str(folder / "scene.xml")
            save_figure(staging / "scene.png", scene.draw())
        replace_files(staging, folder, SCENE_FILES, "scene.xml")
    print(page)
    print(f"next: python -m sim {folder / 'scene.xml'} -o {folder / 'frames'}")


if __name__ == "__main__":
    run_command(main)
