"""Datasets: the same bits however they are made, safe to interrupt, honest about bad input."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import zarr
from PIL import Image

from data_gen.__main__ import main
from data_gen.preview import main as preview
from radiometry.autocorrelation import autocorrelate, smooth_by_window

COUNT = 9000
"""Five shards, the last one short."""


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    """Three synthetic photographs, and other files."""
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(8)
    for number, mode in enumerate(("RGB", "L", "CMYK")):
        row, column = np.mgrid[:300, :420]
        pattern = np.sin(row / (9.0 + number)) + np.sin(column / 13.0) + np.hypot(row - 150, column - 200) / 60.0
        grey = (40.0 * (pattern - pattern.min()) + 4.0 * rng.standard_normal(pattern.shape)).clip(0, 255)
        Image.fromarray(grey.astype(np.uint8)).convert(mode).save(folder / f"{mode}.jpg")
    Image.new("L", (40, 30), 7).save(folder / "tiny.png")
    Image.new("L", (300, 300), 7).save(folder / "flat.png")
    (folder / "torn.jpg").write_bytes((folder / "RGB.jpg").read_bytes()[:900])
    (folder / "notes.txt").write_text("no picture")
    return folder


def digest(store: Path) -> str:
    """SHA-256 of every file of a store, names included."""
    whole = hashlib.sha256()
    for file in sorted(path for path in store.rglob("*") if path.is_file()):
        whole.update(file.relative_to(store).as_posix().encode() + file.read_bytes())
    return whole.hexdigest()


def start(*arguments: object, **settings) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "data_gen", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
        **settings,
    )


def wait_for_shard(store: Path, process: subprocess.Popen) -> None:
    """Until the first shard is whole (or the process ended)."""
    deadline = time.monotonic() + 60.0
    while process.poll() is None and time.monotonic() < deadline:
        if any((store / "complete" / "c").glob("*")):
            return
        time.sleep(0.01)


@pytest.fixture(scope="module")
def arguments(photographs) -> tuple:
    return ("--images", photographs, "--source", "mixed", "--measurement", "noise-model", "--count", COUNT, "--seed", 3)


@pytest.fixture(scope="module")
def reference(tmp_path_factory, arguments) -> Path:
    """A dataset that one worker made."""
    store = tmp_path_factory.mktemp("one") / "set.zarr"
    before = dict(os.environ)
    main([str(item) for item in (store, *arguments, "--workers", 1)])
    # Dask's OMP_NUM_THREADS=1 must not reach what this process starts later.
    assert {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"} == {
        name: value for name, value in before.items() if name != "PYTEST_CURRENT_TEST"
    }
    return store


@pytest.mark.slow
def test_two_workers_give_the_same_bits(tmp_path, arguments, reference):
    store = tmp_path / "set.zarr"
    process = start(store, *arguments, "--workers", 2)
    assert process.communicate()[1].count("Traceback") == 0
    assert digest(store) == digest(reference)


@pytest.mark.slow
def test_killed_and_run_again_gives_the_same_bits(tmp_path, arguments, reference):
    store = tmp_path / "set.zarr"
    process = start(store, *arguments, "--workers", 1, start_new_session=True)
    wait_for_shard(store, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    complete = np.asarray(zarr.open_group(store, mode="r")["complete"])
    assert 0 < complete.sum() < len(complete)
    main([str(item) for item in (store, *arguments, "--workers", 1)])
    assert digest(store) == digest(reference)


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(tmp_path, arguments, reference):
    psutil = pytest.importorskip("psutil")
    store = tmp_path / "set.zarr"
    process = start(store, *arguments, "--workers", 2)
    wait_for_shard(store, process)
    workers = [
        child for child in psutil.Process(process.pid).children(recursive=True) if "spawn_main" in " ".join(child.cmdline())
    ]
    workers[0].kill()
    assert process.wait() == 0, process.communicate()[1]
    process.communicate()
    for leftover in store.rglob("*.partial"):
        leftover.unlink()
    assert digest(store) == digest(reference)


@pytest.mark.slow
def test_a_full_disk_is_an_error_that_leaves_a_store_to_go_on_with(tmp_path, arguments, reference):
    store = tmp_path / "set.zarr"
    full = start(
        store,
        *arguments,
        "--workers",
        1,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000_000, 20_000_000)),
    )
    message = full.communicate()[1]
    assert full.returncode == 2
    assert len(message.strip().splitlines()) == 1
    assert "File too large" in message
    main([str(item) for item in (store, *arguments, "--workers", 1)])
    assert digest(store) == digest(reference)


def test_arrays_and_manifest(reference, photographs, command, tmp_path):
    group = zarr.open_group(reference, mode="r")
    albedo, split = np.asarray(group["albedo"]), np.asarray(group["split"])
    assert albedo.shape == (COUNT, 64, 64)
    assert albedo.dtype == np.uint8
    assert (albedo.reshape(COUNT, -1).max(1) > 0).all()
    assert group["autocorrelation"].dtype == np.float16
    assert 0.0 < split.mean() < 0.3
    attributes = group.attrs.asdict()
    assert [name for name, _ in attributes["photographs"]] == ["CMYK.jpg", "L.jpg", "RGB.jpg"]
    assert {name for name, _ in attributes["skipped"]} == {"flat.png", "notes.txt", "tiny.png", "torn.jpg"}
    assert attributes["photographs"][2][1] == hashlib.sha256((photographs / "RGB.jpg").read_bytes()).hexdigest()
    assert attributes["arguments"]["seed"] == 3
    json.dumps(attributes)
    code, out, _ = command(preview, reference, "-o", tmp_path / "sheet.png")
    assert code == 0
    assert "24 of 9000" in out
    assert np.asarray(Image.open(tmp_path / "sheet.png")).std() > 0


def test_measurements_have_the_noise_that_is_written_beside_them(reference):
    group = zarr.open_group(reference, mode="r")
    lags = np.asarray(group["autocorrelation"][:512], np.float64)
    floor, dof = np.asarray(group["floor_over_peak"][:512], np.float64), np.asarray(group["dof"][:512], np.float64)
    np.testing.assert_array_equal(lags, lags[:, ::-1, ::-1])
    # S by numpy's exact window, then every lag of the lower half: Gamma noise of mean S and shape K.
    for row in range(0, 512, 40):
        albedo = np.asarray(group["albedo"][row], np.float64) / 255.0
        expected = smooth_by_window(autocorrelate(albedo)) / (albedo**2).sum() + floor[row]
        ratio = (lags[row] / expected)[:63].ravel()
        assert abs(ratio.mean() - 1.0) < 4.5 / np.sqrt(dof[row] * ratio.size) + 1e-4
        assert ratio.var(ddof=1) * dof[row] == pytest.approx(1.0, abs=4.5 * np.sqrt((2.0 + 6.0 / dof[row]) / ratio.size) + 0.01)
    assert floor.min() < 0.02 < 0.5 < floor.max()
    assert dof.min() < 6 < 700 < dof.max()


def test_split_is_by_origin(reference):
    group = zarr.open_group(reference, mode="r")
    blocks = np.asarray(group["split"])[: COUNT // 64 * 64].reshape(-1, 64)
    assert (blocks == blocks[:, :1]).all()


def test_torch_dataset(reference):
    from data_gen.dataset import DatasetSplit, load_targets

    training, validation = DatasetSplit(str(reference)), DatasetSplit(str(reference), validation=True)
    assert len(training) + len(validation) == COUNT
    sample = validation[5]
    assert sample["albedo"].shape == (64, 64)
    assert sample["autocorrelation"].dtype == torch.float32
    pool, held_out = load_targets(str(reference))
    assert (len(pool), len(held_out)) == (len(training), len(validation))
    torch.testing.assert_close(held_out[5].float() / 255.0, sample["albedo"])


def test_bad_input(tmp_path, photographs, reference, command):
    (tmp_path / "empty").mkdir()
    Image.new("L", (300, 300), 7).save(tmp_path / "empty" / "flat.png")
    (tmp_path / "file").write_text("")
    before = digest(reference)
    cases = [
        ((tmp_path / "a.zarr", "--images", tmp_path / "empty", "--count", 10), "--images: expected photographs"),
        ((tmp_path / "a.zarr", "--images", tmp_path / "nowhere", "--count", 10), "--images: expected a folder"),
        ((tmp_path / "a.zarr", "--count", 10), "targets: expected --images FOLDER or --source"),
        ((tmp_path / "a.zarr", "--source", "edges", "--count", 10), "add --images"),
        ((tmp_path / "a.zarr", "--source", "glyphs", "--count", 0), "--count"),
        ((tmp_path / "a.zarr", "--source", "glyphs", "--count", 10, "--workers", 0), "--workers"),
        ((tmp_path / "a.zarr", "--source", "glyphs", "--count", 10, "--measurement", "render"), "--scene"),
        ((tmp_path / "a.zarr", "--source", "glyphs", "--count", 10, "--measurement", "noise-model", "--dof", 9, 2), "--dof"),
        ((tmp_path / "a.zarr", "--source", "glyphs", "--count", 10, "--dof", 2, 9), "remove them"),
        ((tmp_path / "file" / "a.zarr", "--source", "glyphs", "--count", 10), "can be written to"),
        ((reference, "--source", "glyphs", "--count", 10), "was begun with"),
    ]
    for arguments, text in cases:
        code, _, err = command(main, *arguments)
        assert code == 2, arguments
        assert text in err, err
        assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "a.zarr").exists()
    assert digest(reference) == before
    code, out, _ = command(main, tmp_path / "a.zarr", "--images", photographs, "--count", 2_000_000, "--dry-run")
    assert code == 0
    assert "4 files skipped" in out
    assert "2000000 targets" in out
    assert not (tmp_path / "a.zarr").exists()
    code, _, err = command(preview, tmp_path / "file")
    assert code == 2


def test_an_unfinished_dataset_is_not_read(tmp_path, command):
    store = tmp_path / "set.zarr"
    assert command(main, store, "--source", "strokes", "--count", 100, "--workers", 1)[0] == 0
    zarr.open_group(store, mode="r+")["complete"][0] = 0
    code, _, err = command(preview, store)
    assert code == 2
    assert "1 of 1 parts missing" in err


def test_measurements_in_a_scene_have_the_lags_of_their_targets(rng):
    pytest.importorskip("mitsuba")
    from data_gen.measurement import SceneMeasurement
    from scenes import scene_path

    place, albedo = SceneMeasurement(str(scene_path("corner_letter")), lags=95), np.zeros((96, 96), np.float32)
    albedo[30:60, 40:52] = rng.random((30, 12), np.float32)
    floor, peak = place.noise_level(albedo)
    modelled = place.model(torch.from_numpy(albedo)[None], torch.tensor([floor / peak]), torch.Generator().manual_seed(1))
    assert modelled.shape == (1, 191, 191)
    assert np.corrcoef(modelled[0].numpy().ravel(), place.render(albedo, 3).ravel())[0, 1] > 0.8


@pytest.mark.slow
def test_rendered_and_modelled_measurements_agree():
    """Per-lag mean and variance of one target's estimates, rendered and from the noise model: two-sample z-tests."""
    pytest.importorskip("mitsuba")
    from correlograph.lags import LAGS, lag_grid
    from data_gen.measurement import SceneMeasurement
    from data_gen.targets import draw_block, target_source

    half_plane = lag_grid(LAGS).half_plane

    from scenes import scene_path

    place = SceneMeasurement(str(scene_path("corner_letter")))
    targets, _ = draw_block(target_source("shapes", None), 5, 1)
    albedo = targets[3].astype(np.float32) / 255.0
    rendered = np.stack([place.render(albedo, seed) for seed in range(16)])
    floor, peak = place.noise_level(albedo)
    model = place.model(
        torch.from_numpy(albedo).expand(400, 64, 64), torch.full((400,), floor / peak), torch.Generator().manual_seed(1)
    ).numpy()
    assert rendered.mean(0)[half_plane].mean() == pytest.approx(model.mean(0)[half_plane].mean(), rel=0.01)
    # A frame holds finitely many grains, so its brightness, and with it the whole estimate, scatters by a percent. That
    # common scale carries nothing of a shape, and the noise model leaves it out.
    rendered *= (model.mean(0)[half_plane].mean() / rendered[:, half_plane].mean(1))[:, None, None]
    difference = (rendered.mean(0) - model.mean(0))[half_plane]
    error = np.sqrt(rendered.var(0, ddof=1) / 16 + model.var(0, ddof=1) / 400)[half_plane]
    z = difference / error
    # The mean over lags, in standard deviations of the model: frames are independent, lags of one frame are not, since they
    # share what is left of its brightness. The scatter between frames is the error. Estimates are skewed; divided by their own
    # scatter over 16 frames, even the right mean would be off.
    of_frames = ((rendered - model.mean(0)) / model.std(0, ddof=1))[:, half_plane].mean(1)
    assert abs(of_frames.mean()) < 5.0 * of_frames.std(ddof=1) / np.sqrt(len(of_frames))
    assert of_frames.std(ddof=1) < 5.0 / np.sqrt(z.size)
    # Student's t of 15 degrees of freedom has the variance 15 / 13.
    assert z.std() == pytest.approx(np.sqrt(15 / 13), rel=0.1)
    ratio = rendered.var(0, ddof=1)[half_plane] / model.var(0, ddof=1)[half_plane]
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
