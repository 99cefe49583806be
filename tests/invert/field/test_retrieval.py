"""`--method field` on frames of an independent generator: finer than the coarse albedo, certified, reproducible."""

import json

import numpy as np
import pytest
import torch
from scipy import ndimage

import correlograph as cg
from correlograph.errors import InputError
from invert.__main__ import main as invert
from invert.choices import FAST
from invert.field.frame_retrieval import search_steps
from invert.field.prior import prior_from_albedo
from invert.field.retrieval import Pass, prepare, retrieve_fields
from invert.measure.estimate import estimate_from_frames
from invert.output.result_files import expected_files
from invert.request import Request
from tests.invert.field.speckle import expected_frame, letter

PATCH, SHAPE = 128, (400, 452)


def capture_of(albedo, photons, frames, seed):
    """Return frames whose pixels collect `photons` electrons on average."""
    rng = np.random.default_rng(seed)
    return [rng.poisson(photons * expected_frame(albedo, SHAPE, PATCH, rng)).astype(np.float32) for _ in range(frames)]


@pytest.fixture(scope="module")
def bright():
    """Result of two bright frames of the letter with the default quality."""
    return cg.reconstruct(capture_of(letter(), 2.0, 2, 11), method="field", patch=PATCH, blur_pixels=0.0)


def test_fields_are_finer_than_the_autocorrelation(bright):
    assert bright.fields is not None
    cells = bright.fields.cells_per_lag
    assert bright.albedo.shape == (64 * cells, 64 * cells)
    assert bright.coarse_albedo.shape == (64, 64)
    truth = np.kron(letter(), np.ones((cells, cells))).astype(np.float32)
    enlarged = ndimage.zoom(bright.coarse_albedo, cells, order=3, grid_mode=True, mode="grid-constant").clip(0.0)
    fine, coarse = (cg.aligned_pearson(one, truth)[0] for one in (bright.albedo, enlarged))
    assert fine > 0.95
    assert fine > coarse
    assert bright.fields.certificate.gain_sigma > 8.0
    assert bright.fields.resolution_lags < 1.0
    assert bright.compare(letter()).pearson > 0.96


def count_passes(monkeypatch):
    """Return a list that grows with every pass over the frames."""
    passes, combine = [], Pass.of
    monkeypatch.setattr(Pass, "of", lambda outcomes: passes.append(combine(outcomes)) or passes[-1])
    return passes


@pytest.mark.slow
def test_threads_do_not_change_the_fields(bright, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    again = cg.reconstruct(capture_of(letter(), 2.0, 2, 11), method="field", patch=PATCH, blur_pixels=0.0)
    assert again.albedo.tobytes() == bright.albedo.tobytes()
    assert again.fields.field.samples.tobytes() == bright.fields.field.samples.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("photons", [0.3, 2.0])
def test_the_weight_of_a_wrong_prior_is_not_understated(photons):
    """The prior is 0.7 times the letter and 0.3 times its mirror image, which frames of the letter do not show."""
    truth, wrong = letter(), letter()[:, ::-1].copy()
    capture = cg.Capture(capture_of(truth, photons, 2, 3))
    estimate = estimate_from_frames(capture, Request(patch=PATCH))
    coarse = 0.7 * truth + 0.3 * wrong
    retrieval = prepare(capture, estimate, coarse, 0).calibrate(1)
    grid = retrieval.model.grid
    found = Pass.of([retrieval.retrieve((retrieval.coarse_prior, number, None)) for number in retrieval.numbers])
    image = torch.stack([one.power for one in found.outcomes]).mean((0, 1)).numpy().ravel()
    parts = np.stack([prior_from_albedo(one, grid).numpy().ravel() for one in (truth, wrong)], 1)
    right, left = np.linalg.lstsq(parts, image, rcond=None)[0]
    weight = left / right / (0.3 * (1.0 + left / right))  # (1 - w) truth + w prior
    assert 0.25 * found.prior_weight < weight < 1.2 * found.prior_weight


@pytest.mark.slow
def test_faint_frames_keep_the_coarse_albedo_with_a_reason(monkeypatch):
    passes = count_passes(monkeypatch)
    result = cg.reconstruct(capture_of(letter(), 0.01, 2, 12), method="field", quality="fast", patch=PATCH, blur_pixels=0.0)
    assert result.object_found
    assert result.fields is None
    assert any("coarse albedo stands" in note for note in result.notes)
    assert result.albedo.shape == (64, 64)
    assert len(passes) <= 2  # nothing is gained by more


@pytest.mark.slow
def test_fast_makes_fewer_passes_with_fewer_steps(bright, monkeypatch):
    passes = count_passes(monkeypatch)
    capture = cg.Capture(capture_of(letter(), 2.0, 2, 11))
    found = retrieve_fields(capture, bright.estimate, bright.reconstruction, 0, quality=FAST)
    assert len(passes) <= 1 + FAST.field_passes
    assert found.certificate.is_accepted
    assert found.certificate.gain_nats_per_pixel == pytest.approx(bright.fields.certificate.gain_nats_per_pixel, rel=0.4)


@pytest.mark.slow
def test_unpolarised_light_has_two_modes():
    first, second = capture_of(letter(), 1.0, 2, 14), capture_of(letter(), 1.0, 2, 16)
    frames = [one + other for one, other in zip(first, second, strict=True)]
    result = cg.reconstruct(frames, method="field", patch=PATCH, blur_pixels=0.0)
    assert result.fields is not None
    assert result.fields.looks == 4
    assert result.fields.background_fraction < 0.1
    assert result.compare(letter()).pearson > 0.95


@pytest.mark.slow
def test_ambient_light_has_one_mode_and_a_background():
    rng = np.random.default_rng(15)
    frame = rng.poisson(2.0 * expected_frame(letter(), SHAPE, PATCH, rng) + 1.0)
    result = cg.reconstruct(frame.astype(np.float32), method="field", patch=PATCH, blur_pixels=0.0)
    assert result.fields is not None
    assert result.fields.looks == 1
    assert result.fields.background_fraction == pytest.approx(1.0 / 3.0, abs=0.06)
    assert result.compare(letter()).pearson > 0.9


@pytest.mark.slow
def test_dark_frames_do_not_spoil_the_albedo(bright):
    frames = capture_of(letter(), 2.0, 2, 11)
    mixed = [frames[0], np.zeros_like(frames[0]), frames[1]]
    result = cg.reconstruct(mixed, method="field", patch=PATCH, blur_pixels=0.0)
    assert result.fields.frames == 2
    assert any("left out" in note for note in result.notes)
    assert result.fields.resolution_lags == pytest.approx(bright.fields.resolution_lags, rel=0.3)


@pytest.mark.slow
def test_saved_results_load_with_their_fields(bright, tmp_path):
    summary = bright.save(tmp_path, letter(), fields=True)
    assert {"albedo_coarse.npy", "deviation.npy", "fields.npz"} <= {path.name for path in tmp_path.iterdir()}
    assert summary["fields"]["certificate"]["accepted"]
    assert summary["pearson"] == pytest.approx(bright.compare(letter()).pearson)
    assert set(expected_files(summary)) == {path.name for path in tmp_path.iterdir() if not path.name.startswith(".")}
    assert "fields.npz" not in expected_files(bright.save(tmp_path))
    loaded = cg.Result.load(tmp_path)
    assert np.array_equal(loaded.albedo, bright.albedo)
    assert np.array_equal(loaded.coarse_albedo, bright.coarse_albedo)
    assert loaded.fields.certificate == bright.fields.certificate
    cg.reconstruct(capture_of(letter(), 2.0, 1, 11), quality="fast", patch=PATCH).save(tmp_path)
    assert not (tmp_path / "fields.npz").exists()


def test_the_report_shows_coarse_and_fine_albedo_registered(bright):
    figure = bright.plot(letter()[::-1, ::-1].copy())  # the report registers everything to the truth
    titles = {axes.get_title(): axes for part in figure.subfigs for axes in part.axes}
    assert {"albedo from fields", "coarse albedo", "standard deviation of the albedo", "true albedo"} <= set(titles)
    truth, fine, coarse = (
        np.asarray(titles[name].images[0].get_array()) for name in ("true albedo", "albedo from fields", "coarse albedo")
    )
    assert np.corrcoef(truth.ravel(), fine.ravel())[0, 1] > 0.9
    assert np.corrcoef(truth.ravel(), coarse.ravel())[0, 1] > 0.8


def test_an_autocorrelation_is_refused(command, tmp_path):
    with pytest.raises(InputError, match="frames for method field"):
        cg.reconstruct(np.random.default_rng(1).random((127, 127)) * 0.0 + 1.0, method="field", autocorrelation=True)
    np.save(tmp_path / "estimate.npy", np.ones((127, 127), np.float32))
    code, _, error = command(
        invert, "--autocorrelation", tmp_path / "estimate.npy", "-o", tmp_path / "out", "--method", "field"
    )
    assert code == 2
    assert "frames for method field" in error
    code, _, error = command(invert, tmp_path / "estimate.npy", "-o", tmp_path / "out", "--save-fields")
    assert (code, "--method field" in error) == (2, True)


@pytest.mark.slow
def test_the_command_writes_fields(command, tmp_path):
    for number, frame in enumerate(capture_of(letter(), 2.0, 1, 13)):
        np.save(tmp_path / f"frame{number}.npy", frame)
    out = tmp_path / "out"
    code, _, _ = command(invert, tmp_path / "frame0.npy", "-o", out, "--method", "field", "--patch", PATCH, "--save-fields")
    assert code == 0
    summary = json.loads((out / "result.json").read_text())
    assert summary["fields"]["looks"] == 1
    assert summary["fields"]["resolution_lags"] is None
    assert cg.Field.load(out / "fields.npz").samples.dtype == np.complex64


def test_dim_frames_get_more_steps():
    assert search_steps(100.0) == 150
    assert search_steps(1.0) == 800
    assert 150 < search_steps(8.0) < 800
    assert torch.get_num_threads() >= 1


def test_without_a_certified_coarse_prior_neither_resolution_nor_confidence_is_stated(bright, monkeypatch):
    monkeypatch.setattr("invert.field.certificate.MIN_GAIN_SIGMA", 1e9)
    capture = cg.Capture(capture_of(letter(), 2.0, 2, 11))
    found = retrieve_fields(capture, bright.estimate, bright.reconstruction, 0)
    assert (found.agreement, found.confidence, found.resolution_lags) == (None, None, None)
    assert found.as_dict((300e-6, 300e-6))["resolution_m"] is None
    assert "resolution" not in found.describe((300e-6, 300e-6))
    assert bright.fields.confidence > 0.95
