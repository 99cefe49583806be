"""The same results on a GPU as on the CPU; skipped, with the reason, where there is none."""

import json

import numpy as np
import pytest
import torch

from sim.propagation.kernels import KERNELS
from sim.propagation.option import Terms
from sim.propagation.sampling import Scatterers, Wall

pytestmark = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA GPU")]


@pytest.fixture
def scattered(rng) -> tuple[Scatterers, Wall]:
    """Scatterers in a box 10 mm deep, and a wall that is neither square nor centred."""
    place = rng.uniform(-4e-3, 4e-3, (300, 3)) + np.array([0.0, 0.0, 1e-3])
    amplitude = rng.standard_normal(300) + 1j * rng.standard_normal(300)
    wall = Wall(np.array([0.02, -0.01, 0.5]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), (130, 200), 7e-6, 532e-9)
    return Scatterers(place, amplitude), wall


def distance(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def field_of(name: str, scattered: tuple[Scatterers, Wall], **terms) -> np.ndarray:
    return KERNELS[name].propagate(*scattered, Terms(**terms)).cpu().numpy()


@pytest.mark.parametrize(("precision", "limit"), [("float32", 1e-4), ("float64", 1e-9)])
def test_direct(scattered, precision, limit):
    expected = field_of("direct", scattered)
    assert distance(field_of("direct", scattered, precision=precision, device="cuda"), expected) < limit


def test_nufft(scattered):
    pytest.importorskip("cufinufft")
    expected = field_of("direct", scattered)
    assert distance(field_of("nufft", scattered, device="cuda"), expected) < 1e-6


@pytest.mark.parametrize("propagator", ["fraunhofer", "fresnel"])
def test_frames(tmp_path, command, propagator):
    from correlograph.files.exr_frames import read_frame
    from scenes import scene_path
    from sim.__main__ import main as sim

    frames = []
    for device in ("cpu", "cuda"):
        code, _, err = command(
            sim,
            scene_path("corner_letter"),
            "-o",
            tmp_path / device,
            "--mean",
            "--frames",
            1,
            "--device",
            device,
            "--propagator",
            propagator,
        )
        assert code == 0, err
        frames.append(read_frame(tmp_path / device / "frame_0000.exr")[0])
    assert distance(frames[1], frames[0]) < 1e-3


def test_inversion(tmp_path, command, measured):
    from invert.__main__ import main as invert

    albedo = []
    for device in ("cpu", "cuda"):
        code, _, err = command(
            invert, "--autocorrelation", measured / "F_n50_corr_x100_nzero1.png", "-o", tmp_path / device, "--device", device
        )
        assert code == 0, err
        assert json.loads((tmp_path / device / "result.json").read_text())["object_found"]
        albedo.append(np.load(tmp_path / device / "albedo.npy"))
    assert np.corrcoef(albedo[0].ravel(), albedo[1].ravel())[0, 1] > 0.9
