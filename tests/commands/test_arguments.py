"""Public functions and hostile arguments: a value is used or refused by InputError, and no other exception arrives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import correlograph as cg
from sim.plan import Settings

HOSTILE = [
    None, 0, -1, 5, 1.5, True, float("nan"), float("inf"), 10**400, 1 + 1j, "", "x", "a\0b", b"x", (), [], {}, [1, "a"], object(),
    np.array([1, 2]), np.zeros((3, 3)), np.full((64, 64), np.nan), np.array(["a"]), np.int64(-7), np.float64("nan"),
]  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return cg.load("corner_letter")


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    return np.random.default_rng(2).exponential(size=(2, 180, 200)).astype(np.float32)


ARGUMENTS = (
    "method",
    "quality",
    "patch",
    "lags",
    "pitch_m",
    "camera",
    "corrections",
    "blur_pixels",
    "mean_model",
    "weights",
    "seed",
)


@pytest.fixture(scope="module")
def result(frames):
    return cg.reconstruct(frames, method="er", quality="fast")


def calls(scene, frames, result, folder) -> dict[str, Callable[[object], object]]:
    def reconstruct(name: str) -> Callable[[object], object]:
        return lambda value: cg.reconstruct(frames, **{"method": "er", "quality": "fast", name: value})

    samples, image = cg.Samples(np.eye(64)[None] + np.zeros((3, 1, 1))), np.eye(64)
    return {
        **{
            f"reconstruct {name}": reconstruct(name)
            for name in ARGUMENTS
        },
        "reconstruct device": reconstruct("device"),
        "reconstruct progress": reconstruct("progress"),
        "reconstruct source": lambda value: cg.reconstruct(value, method="er", quality="fast"),
        "load": cg.load,
        "load parameter": lambda value: cg.load("corner_letter", exposure=value).geometry,
        "render": lambda value: cg.render(value, frames=1),
        "render seed": lambda value: cg.render(scene, frames=1, seed=value),
        "predict": cg.predict,
        "predict frames": lambda value: cg.predict(scene, frames=value),
        "predict patch": lambda value: cg.predict(scene, patch=value),
        "light_budget": cg.light_budget,
        "sweep parameter": lambda value: scene.sweep(value, [1.0]),
        "sweep values": lambda value: [one.geometry for one in scene.sweep("exposure", value)],
        "sweep one value": lambda value: [one.geometry for one in scene.sweep("power", [value])],
        "through": scene.through,
        "monte_carlo": scene.monte_carlo,
        "plan": scene.plan,
        "Scene": cg.Scene,
        "Settings accuracy": lambda value: Settings(accuracy=value),
        "Settings tolerance": lambda value: Settings(tolerance=value),
        "Settings propagator": lambda value: Settings(propagator=value),
        "Settings precision": lambda value: Settings(precision=value),
        "Settings effects": lambda value: Settings(effects=value),
        "CameraMetadata": cg.CameraMetadata,
        "Capture": cg.Capture,
        "Capture camera": lambda value: cg.Capture(list(frames), value),
        "Capture.load": cg.Capture.load,
        "Corrections": lambda value: cg.Corrections(value).apply(cg.Capture(list(frames))),
        "Result.load": cg.Result.load,
        "Result.save": result.save,
        "Result.save truth": lambda value: result.save(folder, value),
        "Result.plot": result.plot,
        "Samples": cg.Samples,
        "interval size": lambda value: samples.interval(value, 0.5),
        "interval probability": lambda value: samples.interval("width", value),
        "score": lambda value: cg.score(value, image),
        "score truth": lambda value: cg.score(image, value),
        "aligned_pearson": lambda value: cg.aligned_pearson(value, image),
    }  # fmt: skip


def test_no_argument_raises_another_exception(scene, frames, result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    failures = []
    for name, call in calls(scene, frames, result, tmp_path / "out").items():
        for value in HOSTILE:
            try:
                call(value)
            except cg.InputError as error:
                if len(str(error).splitlines()) != 1 or len(str(error)) > 900:
                    failures.append(f"{name}({value!r:.40}): message {str(error)[:80]!r}")
            except Exception as error:
                failures.append(f"{name}({value!r:.40}): {type(error).__name__}: {error!s:.80}")
    assert not failures, "\n".join(failures)
