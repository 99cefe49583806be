"""Recording of frames: every frame that leaves the simulator, with its header, comes from here."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.exr_frames import FrameHeader
from correlograph.files.file_metadata import rendered_metadata
from correlograph.version import version
from sim.frame import Simulation
from sim.plan import Plan
from sim.scene_warnings import WITHIN_A_GRAIN


class Recording:
    """The frames of a plan. `python -m sim`, `render`, `mi.render` and the live view draw their frames from one.

    Raises InputError for an object so small or so far away that a grain of its speckle is larger than the frame.

    Args:
        mean: whether frames are expected photoelectrons, without photon and camera noise.
        digest: SHA-256 of the scene, for the headers.
    """

    def __init__(self, plan: Plan, seed: int = 0, *, mean: bool = False, device: str = "cpu", digest: str = "") -> None:
        if plan.geometry.is_within_a_grain:
            extent = " x ".join(f"{1e3 * one:.3g}" for one in plan.geometry.hidden_object.extent_m)
            expected = "an object with several grains of speckle in a frame"
            remedy = "enlarge it, come closer, or photograph more of the wall"
            raise InputError(
                "hidden_object", expected, f"{extent} mm at {plan.geometry.distance_m:.3g} m: {WITHIN_A_GRAIN}", remedy
            )
        self.plan, self.seed, self.mean, self.digest = plan, seed, mean, digest
        self._simulation = Simulation(plan.geometry, device=device, plan=plan)

    def frame(self, number: int, seed: int | None = None) -> np.ndarray:
        """Return a frame in photoelectrons, float32 (H, W); `seed` takes the place of that of the recording."""
        draw = self._simulation.expected_frame if self.mean else self._simulation.frame
        return draw(self.seed if seed is None else seed, number).numpy()

    def header(self, number: int) -> FrameHeader:
        """Return the header of a frame file."""
        geometry, camera = self.plan.geometry, self.plan.geometry.camera
        return FrameHeader(
            geometry.wavelength_m,
            camera.pixel_pitch_m,
            geometry.distance_m,
            camera.electronics.exposure_s,
            self.seed,
            number,
            self.digest,
            version(),
            camera.pupil_diameter_m,
            camera.pupil_distance_m,
            *geometry.seen_pitch_m,
        )

    @property
    def camera(self) -> CameraMetadata:
        """Metadata that a reconstruction needs."""
        return CameraMetadata.of(self.header(0))

    def saturation(self, frame: np.ndarray) -> float:
        """Return the fraction of the pixels of a frame that reached the full well or the range of the ADC."""
        ceiling = self.plan.geometry.camera.electronics.ceiling
        return float((frame >= ceiling * (1.0 - 1e-6)).mean()) if ceiling else 0.0

    def frames(self, count: int) -> Iterator[np.ndarray]:
        """Yield the first frames."""
        return map(self.frame, range(count))

    def capture(self, count: int) -> Capture:
        """Return a capture in memory, without truth and record."""
        headers = tuple(self.header(number) for number in range(count))
        names = tuple(f"frame_{number:04d}" for number in range(count))
        written = rendered_metadata(headers[0].exposure_s)
        return Capture(list(self.frames(count)), self.camera, names, headers=headers, file_metadata=written)
