"""Simulation of one frame, from geometry to photoelectrons."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch

from correlograph.errors import InputError
from radiometry.light_budget_rows import light_budget
from radiometry.sensor.chain import expose
from sim.effects import remaining_electronics
from sim.foreseen import check_foreseen
from sim.geometry import Geometry
from sim.optics.camera import mean_image, transfer_function
from sim.optics.detector_roughness import exact_image, gamma_image
from sim.optics.illumination import Displaced, illuminate
from sim.optics.motion import Moved, Pose, move, poses, tilt
from sim.optics.other_light import StrayLight
from sim.plan import STATIC, Plan, Settings
from sim.propagation.kernels import KERNELS
from sim.propagation.option import Terms, Visibility
from sim.propagation.sampling import Scatterers, kernel, middle, phasor


@dataclass(frozen=True)
class _Mode:
    """A coherent mode of a frame: polarisation (0 or 1, each with independent random phases), offset of a spectral line from the
    laser frequency, pose of object and spot, and the hidden object that it comes from; None for all.
    """

    polarisation: int
    offset_hz: float
    pose: Pose
    part: int | None = None


class Simulation:
    """State that all frames of a scene share; `frame(seed, number)` simulates one frame.

    Raises InputError if the object or the virtual detector cannot be modelled with these settings.
    """

    def __init__(
        self, geometry: Geometry, settings: Settings | None = None, device: str = "cpu", *, plan: Plan | None = None
    ) -> None:
        self.device = torch.device(device)
        self._transfer = transfer_function(geometry).to(self.device)
        self._follow(plan or Plan.of(geometry, settings))

    def _follow(self, plan: Plan) -> None:
        self.plan, self.geometry, self.settings = plan, plan.geometry, plan.settings
        self.propagator, self.effects, self._modes, self._samples = plan.kernel, plan.effects, plan.modes, plan.samples
        self._electronics = remaining_electronics(self.geometry.camera.electronics, self.effects)
        self._gain: np.ndarray | None = None
        self._stray = plan.stray if self._models("other_light") else StrayLight(None, None)
        self._paint = self._paint_on_canvas() if self._models("detector_texture") else None
        self._ambient = self._ambient_light()
        self.budget = light_budget(self.geometry.light_path)

    def _models(self, effect: str) -> bool:
        return self.effects[effect].modelled

    def with_object(self, cells: np.ndarray, pitch_m: float | tuple[float, float]) -> Simulation:
        """Return the same simulation with a flat object of albedo cells (n, n) instead of the object of the scene."""
        other = copy(self)
        other._follow(Plan.of(self.geometry.with_object(cells, pitch_m), self.settings))
        return other

    @property
    def mean_photoelectrons(self) -> float:
        """Expected photoelectrons of one pixel from the hidden object, over all speckle realisations."""
        return self.plan.mean_photoelectrons

    def wall_field(self, seed: int, number: int) -> torch.Tensor:
        """Return the complex field of one coherent mode on the virtual detector; |E|^2 averages to the total relative power
        of the object's samples.

        Returns:
            complex64 (H, W); complex128 if the propagator works in double precision.
        """
        canvas = self._canvas_field(seed, number, _Mode(0, 0.0, self._poses(number)[0]), 1)
        return middle(canvas, self.geometry.camera.frame_shape)

    def _canvas_field(self, seed: int, number: int, mode: _Mode, oversampling: int) -> torch.Tensor:
        """Return the field on the frame and on a border, from which the camera blur brings light into the frame."""
        samples, option, pose = self._samples, self.propagator, mode.pose
        apart = pose.time_s is not None and self.geometry.moves_on_lattice and len(self.geometry.movements) > 1
        if apart and mode.part is None:  # on one lattice, but each object with a phase of its own
            parts = [replace(mode, part=int(part)) for part in np.unique(samples.part)]
            return sum(self._canvas_field(seed, number, one, oversampling) for one in parts)
        moved = None if pose.time_s is None else move(self.geometry, samples, pose.time_s)
        if pose.time_s is not None:
            check_foreseen(self.geometry, pose.time_s)
        height, width = samples.wall.shape
        wall = replace(
            samples.wall if moved is None else moved.wall,
            shape=(height * oversampling, width * oversampling),
            pitch_m=samples.wall.pitch_m / oversampling,
        )
        rows, columns = self.geometry.period_shape
        period = (rows * oversampling, columns * oversampling)
        lit = illuminate(
            self.geometry,
            samples.grid,
            lambda frame: _stream(seed, frame, 2 * mode.polarisation),
            number,
            grain=self._models("source_grain"),
            displaced=self._places(pose.spot_m, moved, mode.part or 0),
        )
        scatterers, chosen = samples.lit(lit, period, mode.offset_hz), KERNELS[option.propagator]
        if mode.part is not None:
            scatterers = replace(scatterers, amplitude=scatterers.amplitude * (samples.part == mode.part))
        if moved is not None:
            scatterers = _displace(scatterers, moved, self.geometry.wavelength_m, on_lattice=chosen.on_lattice)
        terms = Terms(option.precision, device=self.device.type)
        if not chosen.on_lattice:
            visible = self.geometry.hidden_object.visible_from(self.geometry.camera.centre, wall.centre_m)
            visible = visible if chosen.sees_occluders else None
            scatterers = replace(scatterers, amplitude=scatterers.amplitude * self._kernel_gain(visible))
            terms = replace(terms, visible=visible)
        if option.patches is not None:
            terms = replace(terms, tolerance=option.patches.tolerance, patches=option.patches if oversampling == 1 else None)
        field = chosen.propagate(scatterers, wall, terms)
        if pose.time_s is not None and mode.part is not None and chosen.on_lattice:
            field = field * torch.from_numpy(tilt(self.geometry, wall, mode.part, pose.time_s)).to(self.device)
        return field

    def _places(self, spot_m: float, moved: Moved | None, part: int) -> Displaced:
        if moved is None:
            return Displaced(spot_m)
        shift = None if moved.shifts_m is None else moved.shifts_m[part]
        return Displaced(spot_m, self._samples.place, moved.coordinates_m, shift, self.geometry.wander_m)

    def _kernel_gain(self, visible: Visibility | None) -> np.ndarray:
        """Return factors (n,), one per sample, that divide out the propagator's rms amplitude over the frame.

        The power of the samples already includes distance and occlusion; without these factors, the propagator would apply
        them again.
        """
        if self._gain is None:
            samples = self._samples
            node = (np.polynomial.legendre.leggauss(3)[0] + 1.0) / 2.0
            weight = np.polynomial.legendre.leggauss(3)[1] / 2.0
            rows, columns = (side * node - 0.5 for side in samples.wall.shape)
            pixel = samples.wall.pixels(*(part.ravel() for part in np.meshgrid(rows, columns, indexing="ij")))
            power = np.abs(kernel(samples.wall, pixel[:, None], samples.position_m[None])) ** 2
            if visible is not None:
                power = power * visible(pixel, samples.position_m) ** 2
            mean = np.outer(weight, weight).ravel() @ power
            self._gain = np.divide(1.0, np.sqrt(mean), out=np.zeros_like(mean), where=mean > 1e-3)
        return self._gain

    def expected_frame(self, seed: int, number: int) -> torch.Tensor:
        """Return the expected photoelectrons of one frame's speckle without photon and camera noise: float32 (H, W).

        It is the incoherent sum over polarisations, spectral lines and the sub-exposures of a motion. A camera with polarisation
        channels records frames 2 k and 2 k + 1 in one exposure.
        """
        if len(self._samples.amplitude) == 0:
            return self._ambient.expand(self.geometry.camera.frame_shape).clone().cpu()
        factor, polarisations = self._modes.oversampling, self._modes.polarisations
        exposure, channel = divmod(number, self.geometry.camera.polarisation_channels)
        exact = self._modes.exact_roughness
        texture = None if self._paint is None else _repeat(self._paint.sqrt(), factor)
        total = torch.zeros(self.geometry.canvas_shape, device=self.device)
        poses = self._poses(exposure)
        modes = (
            (_Mode(polarisation, offset_hz, poses[index], part), weight / len(poses), index)
            for polarisation in range(channel, channel + polarisations)
            for offset_hz, weight in self._modes.lines
            for index in range(len(poses))
            for part in self._modes.objects
        )
        # Things at rest, lit by a spot at rest, send the same speckle in every frame.
        rng, waves = _stream(seed, channel if self.geometry.spot.scan_step_m == 0.0 else number, 4), {}
        for mode, weight, index in modes:
            polarisation, offset_hz = mode.polarisation, mode.offset_hz
            wall = torch.zeros((), dtype=torch.complex64, device=self.device)
            if mode.part != STATIC:
                wall = self._canvas_field(seed, exposure, mode, factor).to(torch.complex64)
            if self._stray.coherent is not None and mode.part in (None, STATIC):
                if polarisation not in waves:
                    waves[polarisation] = self._stray.coherent.waves(self.geometry, poses, rng)
                wall = wall + self._stray_field(waves[polarisation][index], offset_hz, factor)
            if texture is not None:
                wall = wall * texture
            if exact:
                # one rough wall for all modes
                image = exact_image(wall, factor, self.geometry, _stream(seed, exposure, 3))
            else:
                image = wall.real.square() + wall.imag.square()
            total.add_(image, alpha=weight / polarisations)
        if (background := self._stray.background) is not None:
            image = background.intensity(self.geometry, rng, self.device)
            if self._paint is not None:
                image = image * self._paint
            if exact and self._models("pupil_and_pixel"):
                image = mean_image(image, self._transfer)
            total.add_(image, alpha=background.emitters.share * self._samples.brightness)
        if not exact and self._models("pupil_and_pixel"):
            total = mean_image(total, self._transfer)
        total = middle(total, self.geometry.camera.frame_shape)
        if self._models("detector_roughness") and not exact:
            total = gamma_image(total, self.geometry, _stream(seed, exposure, 3))
        return (total * (self.mean_photoelectrons / self._samples.brightness)).add_(self._ambient).cpu()

    def _stray_field(self, waves: np.ndarray, offset_hz: float, oversampling: int) -> torch.Tensor:
        """Return the field of the stray light that beats with the object, on the canvas of `_canvas_field`."""
        emitters = self._stray.coherent
        assert emitters is not None
        rows, columns = self._samples.grid
        from_corner = KERNELS[self.propagator.propagator].from_corner
        origin = (0.5 * (rows - 1), 0.5 * (columns - 1)) if from_corner else (0.0, 0.0)
        wall = emitters.field(self.geometry, waves, offset_hz, oversampling, origin)
        return wall.to(self.device) * (emitters.share * self._samples.brightness) ** 0.5

    def _poses(self, number: int) -> list[Pose]:
        moving = ("motion", False) not in self.settings.effects
        return poses(self.geometry, number, self._modes.sub_exposures, moving=moving)

    def _paint_on_canvas(self) -> torch.Tensor:
        """Return the albedo of the virtual detector on the canvas, mean 1."""
        texture = torch.from_numpy(self.geometry.wall.texture).to(self.device)
        height, width = self.geometry.canvas_shape
        down, right = ((n - m) // 2 for n, m in zip((height, width), texture.shape, strict=True))
        return torch.nn.functional.pad(texture[None, None], (right, right, down, down), mode="replicate")[0, 0]

    def _ambient_light(self) -> torch.Tensor:
        """Return the photoelectrons from other emitters, (H, W) or a single zero."""
        rate = self.geometry.ambient_photoelectrons_per_pixel_s
        if rate is None or not self._models("ambient"):
            return torch.zeros(1, 1, device=self.device)
        coarse = torch.from_numpy(rate * self.geometry.camera.electronics.exposure_s).float()[None, None]
        smooth = torch.nn.functional.interpolate(coarse, self.geometry.camera.frame_shape, mode="bilinear", align_corners=False)
        ambient = smooth[0, 0].to(self.device)
        if self._paint is None:
            return ambient
        blurred = mean_image(self._paint, self._transfer) if self._models("pupil_and_pixel") else self._paint
        return ambient * middle(blurred, self.geometry.camera.frame_shape)

    def frame(self, seed: int, number: int) -> torch.Tensor:
        """Return one recorded frame in electrons, float32 (H, W).

        Frame `number` of a capture illuminates another spot of the virtual source, at least one spot diameter away unless
        the laser's `scan_step` is smaller. Its speckle and its noise are therefore independent of other frames. The two
        polarisation channels of an exposure have the same spot, but independent speckle.
        """
        noise = expose(self.expected_frame(seed, number).numpy(), self._electronics, _stream(seed, number, 1))
        return torch.from_numpy(noise)


def _displace(scatterers: Scatterers, moved: Moved, wavelength_m: float, *, on_lattice: bool) -> Scatterers:
    """Return scatterers with the phases and, for a propagator that uses them, the positions of moved samples."""
    path = moved.path_m + moved.frame_path_m if on_lattice else moved.path_m
    position = scatterers.position_m if on_lattice else moved.position_m
    return replace(scatterers, position_m=position, amplitude=scatterers.amplitude * phasor(path, wavelength_m))


def _repeat(values: torch.Tensor, factor: int) -> torch.Tensor:
    """Return values on `factor` samples per pixel and axis."""
    return values.repeat_interleave(factor, 0).repeat_interleave(factor, 1)


def _stream(seed: int, number: int, purpose: int) -> np.random.Generator:
    """Return the random stream of one purpose of one frame.

    0 and 2: phase screens of either polarisation; 1: photons and electronics; 3: roughness of the virtual detector; 4: stray light.
    """
    if seed < 0:
        raise InputError("seed", "zero or a positive whole number", seed, "choose another --seed")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, purpose)))
