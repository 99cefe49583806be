"""`correlograph live SOURCE`: follow a running camera on a local page, for alignment and for the length of an exposure."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.progress import stage
from correlograph.ranges import CONFIDENCE, SEED, SI, WAVELENGTH, Range

if TYPE_CHECKING:
    from correlograph.live.sources import Frames


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="correlograph live", description="Follow a running camera on a local page.")
    p.add_argument("source", nargs="?", help="folder or file to which a camera adds frames")
    p.add_argument("--simulate", metavar="SCENE", help="frames of a scene file or shipped scene instead of a source")
    p.add_argument("-D", dest="definitions", action="append", default=[], metavar="key=value", help="parameter of that scene")
    p.add_argument("--frames-per-s", type=Range(0.01, 1000.0), default=8.0, help="frame rate of the simulated camera (8)")
    p.add_argument("--seed", type=SEED, default=0, help="seed of the simulated frames")
    p.add_argument("-o", "--output", default="live", help="folder for saved captures (live)")
    p.add_argument("--pixel-pitch-m", type=SI, help="pixel pitch on the virtual detector in metres")
    p.add_argument("--wavelength-m", type=WAVELENGTH, help="wavelength in metres, for example 532e-9")
    p.add_argument("--distance-m", type=SI, help="distance from the hidden object to the virtual detector in metres")
    p.add_argument("--exposure-s", type=SI, help="exposure of a frame, for the metadata of saved captures")
    p.add_argument("--dark", type=Path, help="dark frame, or a stack or folder of dark frames")
    p.add_argument("--flat", type=Path, help="flat-field frame")
    p.add_argument("--mask", type=Path, help="image; its zero pixels are excluded")
    p.add_argument(
        "--forget",
        type=Range(0, 10**6),
        default=0,
        metavar="FRAMES",
        help="number of later frames after which a frame no longer counts; 0: never (0)",
    )
    p.add_argument(
        "--until",
        type=CONFIDENCE,
        metavar="CONFIDENCE",
        help="stop when the confidence of a reconstruction reaches this value, 0 to 1",
    )
    p.add_argument("--port", type=Range(0, 65535), default=0, help="port of the page; 0 chooses a free one")
    return p


M_MMAP_THRESHOLD, RETURNED_BYTES = -3, 10**6
"""glibc's number for the size of a block above which freed memory is returned at once, and that size."""


def main(argv: Sequence[str] | None = None) -> None:
    """Open the source, start reading, print the address of the page and serve it until the process is interrupted."""
    options = parser().parse_args(argv)
    if (options.source is None) == (options.simulate is None):
        raise InputError(
            "source", "a folder or file, or --simulate SCENE", "neither" if options.source is None else "both", "choose one"
        )
    _return_memory()
    from correlograph.files.corrections import Corrections

    corrections = Corrections(options.dark, options.flat, options.mask)
    corrections.check()
    source, exposure_s = open_source(options)
    from correlograph.live.page import serve
    from correlograph.live.session import LiveSession
    from correlograph.live.threads import Acquisition

    session = LiveSession(source.camera, exposure_s, options.forget, corrections)
    acquisition = Acquisition(source, session, options.until)
    page = serve(acquisition, Path(options.output), options.port)
    acquisition.start()
    print(f"Open {page.address}", flush=True)
    try:
        page.wait()
    finally:
        acquisition.abandon()
        acquisition.join()


def _return_memory() -> None:
    """Let glibc return freed arrays at once; otherwise the threads keep 0.3 GB of them. Other C libraries do so themselves."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").mallopt(M_MMAP_THRESHOLD, RETURNED_BYTES)


def open_source(options: Any) -> tuple[Frames, float | None]:
    """Return the source of frames and their exposure in seconds, if it is known."""
    from correlograph.files.capture import CameraMetadata
    from correlograph.live.sources import GrowingFiles, SimulatedCamera

    if options.source is not None:
        camera = CameraMetadata(options.wavelength_m, options.pixel_pitch_m, options.distance_m)
        camera.check_complete()
        return GrowingFiles(Path(options.source), camera), options.exposure_s
    with stage("reading the scene"):
        import sim
        from sim.recording import Recording
        from sim.scene_file import parse_definitions

        scene = sim.load(options.simulate, **parse_definitions(options.definitions))
        recording = Recording(scene.plan(), options.seed)
    return SimulatedCamera(recording, options.frames_per_s), scene.geometry.camera.electronics.exposure_s


if __name__ == "__main__":
    run_command(main)
