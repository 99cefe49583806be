"""Every caller of the pipeline gives the same albedo, byte for byte, for one estimate and seed."""

import json
from argparse import Namespace

import numpy as np
import pytest
import torch

import correlograph as cg
from invert.__main__ import main as invert
from invert.choices import FAST, UNET
from invert.evaluation.evaluate import _score_case
from invert.evaluation.sets import Case, Level
from invert.measure.estimate import Estimate, published_estimate
from invert.pipeline import fulfil
from invert.request import Request
from radiometry.autocorrelation import autocorrelate, smooth_by_window


@pytest.fixture
def estimate_file(tmp_path):
    """An estimate of an asymmetric object with noise, as a file."""
    rng = np.random.default_rng(3)
    albedo = np.zeros((64, 64))
    albedo[20:44, 25:29] = albedo[20:24, 25:41] = albedo[30:34, 25:36] = 1.0
    signal = smooth_by_window(autocorrelate(albedo))
    noise = rng.gamma(200.0, 1.0 / 200.0, signal.shape)
    noise = np.where(np.tri(127, 127, -1) > 0, noise, noise[::-1, ::-1])
    lags = (0.2 + signal / signal.max()) * noise
    file = tmp_path / "estimate.npy"
    np.save(file, (0.5 * (lags + lags[::-1, ::-1])).astype(np.float32))
    return file


def test_command_python_batch_evaluation_and_estimates_agree(tmp_path, command, estimate_file):
    code, out, _ = command(invert, "--autocorrelation", estimate_file, "-o", tmp_path / "out", "--quality", "fast", "--seed", 5)
    assert code == 0
    assert "confidence" in out.splitlines()[-1]
    albedo = np.load(tmp_path / "out" / "albedo.npy")
    assert json.loads((tmp_path / "out" / "result.json").read_text())["object_found"]

    estimate = published_estimate(estimate_file)
    by_python = cg.reconstruct(estimate_file, quality="fast", seed=5)
    by_request = fulfil(Request(autocorrelation=True, method=UNET, quality=FAST, seed=5), [estimate_file])
    by_estimate = cg.reconstruct(Estimate("another name", estimate.values), quality=FAST, seed=5)
    level = Level("shapes", "one", [Case("0", estimate, albedo)])
    options = Namespace(seed=5, device="cpu")
    row, by_evaluation = _score_case(level, level.cases[0], {"method": UNET, "quality": FAST}, options)
    for other in (by_python.albedo, by_request.albedo, by_estimate.albedo, by_evaluation):
        assert other.tobytes() == albedo.tobytes()
    assert row["confidence"] == by_python.confidence


@pytest.mark.slow
def test_the_number_of_threads_changes_no_result(estimate_file):
    before, albedos = torch.get_num_threads(), set()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            albedos.add(cg.reconstruct(estimate_file, quality="balanced").albedo.tobytes())
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert len(albedos) == 1


def test_classical_methods_run_no_network(estimate_file, monkeypatch):
    def fail(*_):
        raise AssertionError("a classical method loaded the network")

    monkeypatch.setattr("invert.methods.load_network", fail)
    rng = np.random.default_rng(0)
    frames = rng.exponential(1.0, (2, 400, 400))
    assert not cg.reconstruct(frames, method="hio", quality="fast").object_found
    assert cg.reconstruct(estimate_file, method="classical", quality="fast").object_found


def test_saved_results_and_captures_load(tmp_path, estimate_file):
    result = cg.reconstruct(estimate_file, quality="fast")
    result.save(tmp_path / "saved")
    loaded = cg.Result.load(tmp_path / "saved")
    assert loaded.albedo.tobytes() == result.albedo.tobytes()
    assert (loaded.confidence, loaded.object_found) == (result.confidence, True)
    assert "object found" in repr(loaded)
    assert "<img" in loaded._repr_html_()
    with pytest.raises(cg.InputError, match="result"):
        cg.Result.load(tmp_path)
    with pytest.raises(cg.InputError, match="frame"):
        cg.Capture.load(tmp_path)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("method", {"method": "hi"}),
        ("quality", {"quality": "fats"}),
        ("device", {"device": "gpu"}),
        ("mean_model", {"mean_model": "x"}),
        ("seed", {"seed": -1}),
        ("weights", {"weights": "w.safetensors", "method": "hio"}),
        ("autocorrelation", {"patch": 200}),
    ],
)
def test_invalid_arguments_are_refused(name, arguments, estimate_file):
    with pytest.raises(cg.InputError, match=name):
        cg.reconstruct(estimate_file, **arguments)


def test_views_and_read_only_arrays_are_accepted(estimate_file):
    lags = np.load(estimate_file)
    lags.setflags(write=False)
    turned = np.ascontiguousarray(lags)[::-1, ::-1]
    first, second = (cg.reconstruct(one, quality="fast", method="classical", seed=np.int64(0)) for one in (lags, turned))
    assert first.albedo.tobytes() == second.albedo.tobytes()
    with pytest.raises(cg.InputError, match="frames"):
        cg.reconstruct([np.ones((200, 200)), np.ones((210, 200))])
