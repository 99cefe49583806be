"""Kernels against an independent 50-digit sum, against one another, and against their own predictions."""

import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba")

import sim  # noqa: F401 - sets Dr.Jit's backend
from correlograph.errors import InputError
from sim.propagation import validity
from sim.propagation.choose import choose, options
from sim.propagation.kernels import KERNELS
from sim.propagation.option import Task, Terms
from sim.propagation.sampling import Lattice, Scatterers, Wall

WAVELENGTH_M, PIXEL_M = 532e-9, 6.9e-6


def field_of(name: str, scatterers: Scatterers, wall: Wall, **terms) -> np.ndarray:
    return KERNELS[name].propagate(scatterers, wall, Terms(**terms)).numpy()


def direct(scatterers: Scatterers, wall: Wall, **terms) -> np.ndarray:
    return field_of("direct", scatterers, wall, **terms)


def nufft(scatterers: Scatterers, wall: Wall, **terms) -> np.ndarray:
    return field_of("nufft", scatterers, wall, **terms)


def task(scatterers: Scatterers, wall: Wall, accuracy: str, tolerance: float, **other) -> Task:
    return Task(wall, places(scatterers), scatterers, 3e-4, accuracy, tolerance, **other)


def scattered(rng, count: int, extent_m: tuple[float, float, float]) -> Scatterers:
    waves = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    return Scatterers(rng.uniform(-0.5, 0.5, (count, 3)) * extent_m, waves)


def wall_at(distance_m: float, angle_deg: float, shape: tuple[int, int], wavelength_m: float = WAVELENGTH_M) -> Wall:
    """A frame whose centre lies `angle_deg` off the object's normal z, the wall itself parallel to the object."""
    angle = np.deg2rad(angle_deg)
    centre = distance_m * np.array([np.sin(angle), 0.0, np.cos(angle)])
    return Wall(centre, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), shape, PIXEL_M, wavelength_m)


def on_grid(rng, distance_m: float, grid: tuple[int, int], shape: tuple[int, int], tilt_deg: float = 0.0, depth_m: float = 0.0):
    """Scatterers on the lattice that FFT kernels need, and their wall."""
    pitch = [WAVELENGTH_M * distance_m / (PIXEL_M * n) for n in shape]
    row, column = np.nonzero(rng.random(grid) < 0.3)
    y, x = ((index - 0.5 * (n - 1)) * step for index, n, step in zip((row, column), grid, pitch, strict=True))
    z = np.tan(np.deg2rad(tilt_deg)) * x + rng.uniform(-0.5, 0.5, len(x)) * depth_m
    waves = rng.standard_normal(len(x)) + 1j * rng.standard_normal(len(x))
    lattice = Lattice((row, column), grid, shape)
    return Scatterers(np.stack([x, y, z], 1), waves, lattice), wall_at(distance_m, 0.0, shape)


def places(scatterers: Scatterers) -> np.ndarray:
    """Down and right of scatterers before these walls, whose rows run along y and columns along x."""
    return scatterers.position_m[:, [1, 0]]


def distance(field: np.ndarray, reference: np.ndarray) -> float:
    return float(np.linalg.norm(field - reference) / np.linalg.norm(reference))


def after_one_phase(field: np.ndarray, reference: np.ndarray) -> float:
    overlap = np.vdot(field, reference)
    return distance(field * overlap / abs(overlap), reference)


def fifty_digits(scatterers: Scatterers, wall: Wall, row: int, column: int) -> complex:
    """The definition in `sampling.py`, written out in scalars; shares nothing with the kernels."""
    with mpmath.workdps(50):
        number = mpmath.mpf
        pixel = [
            number(float(c))
            + (row - number(wall.shape[0] - 1) / 2) * number(wall.pitch_m) * number(float(d))
            + (column - number(wall.shape[1] - 1) / 2) * number(wall.pitch_m) * number(float(r))
            for c, d, r in zip(wall.centre_m, wall.down, wall.right, strict=True)
        ]
        centre = [number(float(c)) for c in wall.centre_m]
        carrier = mpmath.sqrt(sum(p * p for p in pixel))
        total = mpmath.mpc(0)
        for place, wave in zip(scatterers.position_m, scatterers.amplitude, strict=True):
            ray = [p - number(float(s)) for p, s in zip(pixel, place, strict=True)]
            square = sum(part * part for part in ray)
            along = sum(part * c for part, c in zip(ray, centre, strict=True))
            phase = 2 * mpmath.pi * (mpmath.sqrt(square) - carrier) / number(wall.wavelength_m)
            total += mpmath.mpc(complex(wave)) * along / square * mpmath.expj(phase)
        return complex(total)


@pytest.mark.parametrize("angle_deg", [0.0, 45.0])
@pytest.mark.parametrize(
    ("distance_m", "wavelength_m"), [(0.01, 355e-9), (0.05, 532e-9), (1.0, 532e-9), (1000.0, 532e-9), (1.0, 1e-3)]
)
def test_direct_float64_is_the_fifty_digit_sum(rng, angle_deg, distance_m, wavelength_m):
    wall = wall_at(distance_m, angle_deg, (70, 131), wavelength_m)
    scatterers = scattered(rng, 12, np.array([1.0, 0.7, 0.4]) * min(0.01, 0.1 * distance_m))
    field = direct(scatterers, wall, precision="float64")
    places = [(0, 0), (69, 130), (35, 65), (3, 100), (64, 64)]
    exact = np.array([fifty_digits(scatterers, wall, *place) for place in places])
    assert distance(np.array([field[place] for place in places]), exact) < 1e-9


def test_one_scatterer_and_zero_scatterers(rng):
    wall = wall_at(1.0, 0.0, (65, 64))
    one = Scatterers(np.array([[1e-3, -2e-3, 5e-4]]), np.array([2.0 - 1.0j]))
    assert abs(direct(one, wall, precision="float64")[10, 20] - fifty_digits(one, wall, 10, 20)) < 1e-9
    assert abs(nufft(one, wall)[10, 20] - fifty_digits(one, wall, 10, 20)) < 1e-5
    assert not direct(Scatterers(np.zeros((0, 3)), np.zeros(0)), wall).any()


@pytest.mark.parametrize(
    ("distance_m", "angle_deg", "allowed"),
    [(0.05, 0.0, 1e-3), (0.05, 45.0, 1e-3), (0.5, 0.0, 1e-4), (1.0, 45.0, 1e-4), (100.0, 45.0, 1e-4)],
)
def test_single_precision(rng, distance_m, angle_deg, allowed):
    wall = wall_at(distance_m, angle_deg, (130, 140))
    scatterers = scattered(rng, 400, (0.01, 0.007, 0.01) if distance_m >= 0.5 else (1e-3, 1e-3, 1e-3))
    reference = direct(scatterers, wall, precision="float64")
    assert distance(direct(scatterers, wall, precision="float32"), reference) < allowed
    assert distance(nufft(scatterers, wall, tolerance=2e-5, precision="float32"), reference) < allowed


@pytest.mark.parametrize(("distance_m", "depth_m"), [(0.5, 1e-2), (1.0, 1e-2), (1.0, 0.0), (10.0, 2e-2)])
def test_nufft_meets_its_tolerance(rng, distance_m, depth_m):
    wall = wall_at(distance_m, 5.0, (300, 517))
    scatterers = scattered(rng, 1000, (0.01, 0.008, depth_m))
    reference = direct(scatterers, wall, precision="float64")
    assert distance(nufft(scatterers, wall, tolerance=1e-6), reference) < 1e-6
    assert distance(nufft(scatterers, wall, tolerance=1e-3), reference) < 1e-3


def test_nufft_refuses_what_it_cannot_hold(rng):
    scatterers = scattered(rng, 30, (0.01, 0.01, 0.0))
    with pytest.raises(InputError, match="float64"):
        nufft(scatterers, wall_at(1.0, 0.0, (130, 130)), tolerance=1e-9, precision="float32")
    with pytest.raises(InputError, match="direct"):
        nufft(scatterers, wall_at(0.006, 0.0, (1000, 1000)), tolerance=1e-6)


@pytest.mark.parametrize(
    ("distance_m", "grid", "tilt_deg", "depth_m"),
    [
        (1.0, (80, 61), 0.0, 0.0),
        (1.0, (31, 20), 0.0, 0.0),
        (100.0, (40, 31), 0.0, 0.0),
        (1.0, (80, 61), 0.0, 1e-3),
        (1.0, (80, 61), 30.0, 0.0),
        (0.1, (60, 61), 0.0, 0.0),
    ],
)
def test_fresnel_errs_as_predicted(rng, distance_m, grid, tilt_deg, depth_m):
    scatterers, wall = on_grid(rng, distance_m, grid, (258, 401), tilt_deg, depth_m)
    measured = after_one_phase(field_of("fresnel", scatterers, wall), direct(scatterers, wall))
    predicted = validity.fresnel_error(wall, places(scatterers), scatterers)
    assert predicted / 3.0 < measured < 3.0 * predicted
    assert (measured < 1e-3) == (predicted < 1e-3)
    if grid == (31, 20):
        assert measured < 1e-3  # inside the rule


def test_fraunhofer_has_the_statistics_but_not_the_field(rng):
    scatterers, wall = on_grid(rng, 1.0, (80, 61), (258, 401))
    field = field_of("fraunhofer", scatterers, wall)
    assert after_one_phase(field, direct(scatterers, wall)) == pytest.approx(validity.UNCORRELATED_FIELD_ERROR, abs=0.1)
    listed = options(task(scatterers, wall, "field", 1e-2))
    assert choose(listed, "fraunhofer", 1e-2).predicted_error == validity.UNCORRELATED_FIELD_ERROR
    assert validity.statistical_error(wall, places(scatterers), scatterers, 3e-4) < 3e-4


def test_the_statistical_error_is_that_of_rendered_speckle(rng):
    """Two bright plates at different depths: mean |FT I|^2 of a patch, over many phases, has its peak where g says."""
    distance_m, shape = 0.1, (128, 128)
    wall = wall_at(distance_m, 0.0, shape)
    count = 60
    near = np.concatenate([rng.uniform(-2e-4, 2e-4, (count, 2)), np.full((count, 1), 0.0)], 1)
    far = near + np.array([2.2e-3, 0.0, 0.02])  # towards the wall: seen wider apart than from the object's own plane
    position = np.concatenate([near, far])
    power = np.zeros(shape)
    for _ in range(40):
        waves = np.exp(2j * np.pi * rng.random(2 * count))
        field = direct(Scatterers(position, waves), wall, precision="float64")
        power += np.abs(np.fft.fft2(np.abs(field) ** 2)) ** 2
    power = np.fft.fftshift(power)
    power[:, 54:75] = 0.0  # lags within one plate
    column = np.abs(np.arange(128) - 64.0)
    seen = float((power * column).sum() / power.sum())
    lag_m = WAVELENGTH_M * distance_m / (128 * PIXEL_M)
    assert seen * lag_m == pytest.approx(2.2e-3 * 0.1 / 0.08, rel=0.03)
    points = Scatterers(position, np.ones(2 * count))
    flat_error = validity.statistical_error(wall, places(points), points, lag_m)
    assert flat_error > 0.5


@pytest.mark.parametrize("accuracy", ["statistical", "field"])
@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-4, 1e-6, 1e-9])
def test_auto_stays_within_its_tolerance(rng, accuracy, tolerance):
    grid = (60, 45)
    scatterers, wall = on_grid(rng, 1.0, grid, (258, 401), depth_m=5e-4)
    found = choose(options(task(scatterers, wall, accuracy, tolerance)), "auto", tolerance)
    assert found.predicted_error <= tolerance
    if accuracy == "field":
        field = field_of(found.propagator, scatterers, wall, precision=found.precision, patches=found.patches)
        assert after_one_phase(field, direct(scatterers, wall)) <= tolerance


def test_unreachable_tolerances_are_refused(rng):
    scatterers, wall = on_grid(rng, 1.0, (20, 20), (130, 130))
    listed = options(task(scatterers, wall, "field", 1e-13))
    with pytest.raises(InputError, match="1e-11 or more"):
        choose(listed, "auto", 1e-13)
    with pytest.raises(InputError, match="--propagator"):
        choose(options(task(scatterers, wall, "field", 1e-3, precisions=("float64",))), "fresnel", 1e-3)


def test_direct_sees_only_what_is_visible(rng):
    wall = wall_at(1.0, 0.0, (128, 128))
    scatterers = scattered(rng, 50, (5e-3, 5e-3, 0.0))
    left = scatterers.position_m[:, 0] < 0.0
    field = direct(scatterers, wall, visible=lambda tiles, samples: np.tile(samples[:, 0] < 0.0, (len(tiles), 1)))
    alone = direct(Scatterers(scatterers.position_m[left], scatterers.amplitude[left]), wall)
    np.testing.assert_allclose(field, alone, atol=1e-5 * np.abs(alone).max())


def test_frames_of_every_kernel_agree(letter_simulation):
    """One seed, one object: the simulator's field by the direct sum and by the others."""
    from sim.frame import Simulation
    from sim.plan import Settings

    geometry = letter_simulation("7").geometry
    cells = np.zeros((64, 64), np.float32)
    cells[30:34, 29:38], cells[34:38, 29:31] = 1.0, 0.5  # small, so that the whole frame by the direct sum takes seconds
    shown = geometry.with_object(cells, 1e-4)
    fields = {
        name: Simulation(shown, Settings("field", 1e-3, name, None)).wall_field(3, 1).numpy()
        for name in ("fresnel", "nufft", "direct")
    }
    assert fields["direct"].shape == geometry.camera.frame_shape
    assert after_one_phase(fields["nufft"], fields["direct"]) < 1e-3
    assert after_one_phase(fields["fresnel"], fields["direct"]) < 1e-2
    fraunhofer = Simulation(shown).wall_field(3, 1)
    assert float((fraunhofer.abs() ** 2).mean()) == pytest.approx(float(np.mean(np.abs(fields["direct"]) ** 2)), rel=0.05)
    assert torch.is_complex(fraunhofer)


BOUNDED = """
import resource, sys
import numpy as np
import sim
from sim.propagation.kernels import KERNELS
from sim.propagation.option import Terms
from sim.propagation.sampling import Scatterers, Wall

kernel, count, side = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
rng = np.random.default_rng(0)
wall = Wall(np.array([0.0, 0.0, 3.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), (side, side), 6.9e-6, 532e-9)
scatterers = Scatterers(rng.uniform(-5e-3, 5e-3, (count, 3)), np.ones(count, complex))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
field = KERNELS[kernel].propagate(scatterers, wall, Terms("float32", 1e-3)).numpy()
assert np.isfinite(field.view(np.float32)).all()
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e6)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "count", "side", "gigabytes"),
    [("direct", 1, 16384, 3.5), ("direct", 1_000_000, 64, 1.5), ("nufft", 1_000_000, 257, 3.0)],
)
def test_memory_is_bounded_whatever_object_and_frame(kernel, count, side, gigabytes):
    """A field of 16 k x 16 k holds 2.1 GB itself."""
    arguments = [sys.executable, "-c", BOUNDED, kernel, str(count), str(side)]
    done = subprocess.run(arguments, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False)
    assert done.returncode == 0, done.stderr[-500:]
    assert float(done.stdout) < gigabytes


@pytest.mark.parametrize("tilt_deg", [60.0, 85.0, 89.0])
def test_grazing_tilt(rng, tilt_deg):
    """A plate almost along the line of sight: nufft against the direct sum, and a prediction that Fresnel fails."""
    scatterers, wall = on_grid(rng, 1.0, (60, 5), (130, 257), tilt_deg=0.0)
    along = np.tan(np.deg2rad(tilt_deg)) * scatterers.position_m[:, 0]
    tilted = Scatterers(scatterers.position_m + along[:, None] * [0.0, 0.0, 1.0], scatterers.amplitude)
    reference = direct(tilted, wall, precision="float64")
    assert distance(nufft(tilted, wall, tolerance=1e-5), reference) < 1e-5
    assert np.isfinite(validity.fresnel_error(wall, places(tilted), tilted))
