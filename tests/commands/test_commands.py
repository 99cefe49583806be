"""The commands as users run them: results, reproducibility, and one clear line for bad input."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage.io import imread

pytest.importorskip("mitsuba")

from invert.__main__ import main as invert
from invert.albedo.metrics import aligned_pearson
from scenes import scene_path
from sim.__main__ import main as sim_main

SCENE = scene_path("corner_letter")


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    """Two frames of the F at 1/8 s, rendered by the command."""
    folder = tmp_path_factory.mktemp("capture")
    sim_main([str(SCENE), "-o", str(folder), "-D", "exposure=0.125", "--seed", "4"])
    return folder


def contents(folder: Path, pattern: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob(pattern)) if path.is_file()}


def test_the_capture_is_complete(capture):
    assert sorted(path.name for path in capture.glob("[!.]*")) == ["frame_0000.exr", "frame_0001.exr", "sim.json", "truth.npy"]
    truth = np.load(capture / "truth.npy")
    assert truth.shape == (64, 64)
    assert truth.dtype == np.float32
    summary = json.loads((capture / "sim.json").read_text())
    assert summary["lag_pitch_m"] == pytest.approx(300e-6, rel=1e-3)
    assert truth.sum() * summary["lag_pitch_m"] ** 2 == pytest.approx(0.2e-4, rel=0.05)
    frames = list(contents(capture, "*.exr").values())
    assert frames[0] != frames[1]


def test_the_letter_comes_back_unmirrored(capture, tmp_path, command):
    code, out, err = command(invert, capture, "-o", tmp_path, "--truth", capture / "truth.npy")
    assert code == 0
    assert re.fullmatch(r"note: --method field would show finer detail: .* enough\), .*\n", err)
    assert "report.png" in out
    result = json.loads((tmp_path / "result.json").read_text())
    albedo, truth = np.load(tmp_path / "albedo.npy"), np.load(capture / "truth.npy")
    assert result["object_found"]
    assert result["pearson"] > 0.85
    assert aligned_pearson(albedo, truth)[0] == pytest.approx(result["pearson"], abs=1e-3)
    assert aligned_pearson(albedo[:, ::-1], truth)[0] < result["pearson"] - 0.1
    assert result["noise"]["dof"] == pytest.approx(325, rel=0.1)
    assert result["noise"]["floor_over_peak"] == pytest.approx(8 * 0.005, rel=0.15)
    assert result["pitch_m"] == pytest.approx(300e-6, rel=1e-3)
    assert set(result["seconds"]) == {"read", "autocorrelation", "retrieval"}
    estimate = np.load(tmp_path / "autocorrelation.npy")
    assert estimate.shape == (127, 127)
    assert albedo.shape == (64, 64)
    assert albedo.dtype == np.float32
    for name in ("report.png", "albedo.png"):
        assert imread(tmp_path / name).shape[1] > 100


def test_one_seed_gives_one_answer(capture, tmp_path):
    sim_main([str(SCENE), "-o", str(tmp_path / "again"), "-D", "exposure=0.125", "--seed", "4"])
    assert contents(capture, "*.exr") == contents(tmp_path / "again", "*.exr")
    assert contents(capture, "*.npy") == contents(tmp_path / "again", "*.npy")
    for name in ("a", "b"):
        invert([str(capture), "-o", str(tmp_path / name), "--quality", "fast"])
    assert contents(tmp_path / "a", "*.npy") == contents(tmp_path / "b", "*.npy")


def test_a_shorter_run_leaves_no_frames_of_a_longer_one(tmp_path):
    sim_main([str(SCENE), "-o", str(tmp_path), "--frames", "3"])
    sim_main([str(SCENE), "-o", str(tmp_path), "--frames", "1"])
    assert [path.name for path in tmp_path.glob("*.exr")] == ["frame_0000.exr"]


def test_a_stopped_run_leaves_the_older_capture_whole(capture, tmp_path, monkeypatch):
    import shutil

    from sim.frame import Simulation

    folder = tmp_path / "capture"
    shutil.copytree(capture, folder)
    before = contents(folder, "[!.]*")
    real = Simulation.frame

    def stop_at_the_second(self, seed, number):
        if number == 1:
            raise KeyboardInterrupt
        return real(self, seed, number)

    monkeypatch.setattr(Simulation, "frame", stop_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        sim_main([str(SCENE), "-o", str(folder), "-D", "albedo=R.png"])
    assert contents(folder, "[!.]*") == before
    monkeypatch.undo()
    sim_main([str(SCENE), "-o", str(folder), "--frames", "1"])
    assert sorted(path.name for path in folder.glob("[!.]*")) == ["frame_0000.exr", "sim.json", "truth.npy"]


def test_mean_frames_are_expectations(tmp_path, letter_simulation):
    from correlograph.files.exr_frames import read_frame

    sim_main([str(SCENE), "-o", str(tmp_path), "--mean", "--frames", "1", "-D", "exposure=1"])
    pixels, _ = read_frame(tmp_path / "frame_0000.exr")
    assert np.array_equal(pixels, letter_simulation("F", exposure="1").expected_frame(0, 0).numpy())


def test_plan_is_json_and_renders_nothing(tmp_path, command):
    code, out, err = command(sim_main, SCENE, "--plan", "-D", "exposure=1")
    plan = json.loads(out)
    assert (code, err) == (0, "")
    assert not any(tmp_path.iterdir())
    assert plan["throughput"]["per_pixel_db"] == pytest.approx(-180.6, abs=0.2)
    assert plan["ideal_floor_over_peak"] == pytest.approx(0.005, rel=0.03)
    assert {"name", "modelled", "why", "predicted_error"} <= set(plan["effects"][0])


def test_an_exposure_too_short_for_a_photon_finds_no_object(tmp_path, command):
    sim_main([str(SCENE), "-o", str(tmp_path / "dark"), "-D", "exposure=1e-12"])
    code, out, _ = command(invert, tmp_path / "dark", "-o", tmp_path / "result", "--truth", tmp_path / "dark" / "truth.npy")
    result = json.loads((tmp_path / "result" / "result.json").read_text())
    assert code == 0
    assert "no object" in out
    assert result["object_found"] is False
    assert result["noise"]["floor_over_peak"] is None
    assert not np.load(tmp_path / "result" / "albedo.npy").any()


def empty_object(folder: Path) -> Path:
    text = SCENE.read_text().replace('"F.png"', f'"{SCENE.parent / "F.png"}"')
    (folder / "empty.xml").write_text(text.replace('id="hidden_object"', 'id="clutter"'))
    return folder / "empty.xml"


def without_source(folder: Path) -> Path:
    text = SCENE.read_text().replace('"F.png"', f'"{SCENE.parent / "F.png"}"')
    (folder / "sourceless.xml").write_text(text.replace('id="virtual_source"', 'id="wall"'))
    return folder / "sourceless.xml"


def malformed(folder: Path) -> Path:
    (folder / "bad.xml").write_text("<scene version='3.0.0'><shape></scene>")
    return folder / "bad.xml"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda f: [f / "no.xml", "-o", f / "out"], "no.xml"),
        (lambda f: [malformed(f), "-o", f / "out"], "well-formed"),
        (lambda f: [without_source(f), "-o", f / "out"], "virtual_source"),
        (lambda f: [empty_object(f), "-o", f / "out"], "hidden_object"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "exposure=-1"], "exposure"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "exposure=nan"], "exposure"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "colour=red"], "colour"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "albedo=none.png"], "none.png"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "standoff=0.1"], "0.259"),
        (lambda f: [SCENE, "-o", f / "out", "--frames", "0"], "--frames"),
        (lambda f: [SCENE, "-o", f / "out", "--seed", "-3"], "--seed"),
        (lambda f: [SCENE, "-o", "/proc/out"], "output folder"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "exposure=1e14"], "electrons"),
        (lambda f: [SCENE, "-o", f / "out", "-D", "power=1", "-D", "power=2"], "power"),
        (lambda f: [SCENE, "-o", f / "out", "--pl"], "--pl"),
        (lambda f: [SCENE], "-o"),
        (lambda f: [SCENE, "--frobnicate"], "frobnicate"),
    ],
)
def test_bad_scenes_are_one_line(tmp_path, command, arguments, words):
    code, out, err = command(sim_main, *arguments(tmp_path))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err
    assert "Traceback" not in err
    assert not list(tmp_path.glob("out/*"))


def saved(folder: Path, **arrays: np.ndarray) -> Path:
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    return folder


NOISE = np.random.default_rng(0).random((260, 260))


def truncated(folder: Path, capture: Path) -> Path:
    (folder / "cut.exr").write_bytes((capture / "frame_0000.exr").read_bytes()[:60000])
    return folder / "cut.exr"


def photograph(folder: Path) -> Path:
    Image.fromarray(np.zeros((300, 300, 3), np.uint8) + np.array([9, 8, 7], np.uint8)).save(folder / "photo.png")
    return folder / "photo.png"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda f, c: [f], "frames"),
        (lambda f, c: [f / "missing"], "missing"),
        (lambda f, c: [saved(f, a=NOISE, b=NOISE[:250])], "one size"),
        (lambda f, c: [saved(f, a=np.where(NOISE > 0.999, np.nan, NOISE))], "NaN"),
        (lambda f, c: [saved(f, a=np.full((260, 260), 3.0))], "same value"),
        (lambda f, c: [photograph(f)], "monochrome"),
        (lambda f, c: [truncated(f, c)], "cut.exr"),
        (lambda f, c: [c, "--patch", "20"], "patch"),
        (lambda f, c: [c, "--patch", "x"], "--patch"),
        (lambda f, c: [c, "--patch", "0"], "patch"),
        (lambda f, c: [c, "--lags", "31"], "--lags"),
        (lambda f, c: [c, "--lags", "63.5"], "--lags"),
        (lambda f, c: [c, "--pitch-m", "0"], "--pitch-m"),
        (lambda f, c: [c, "--patch", "200", "--lags", "150"], "patch"),
        (lambda f, c: [c, "--truth", saved(f, a=NOISE[:50, :50]) / "a.npy"], "pitch"),
        (lambda f, c: [c, "--dark", f / "none.npy"], "--dark"),
        (lambda f, c: [saved(f, a=NOISE, b=NOISE[::-1]), "--distance-m", "1"], "--wavelength-m"),
        (lambda f, c: [saved(f, a=NOISE * 1e30)], "pixels up to"),
        (lambda f, c: [saved(f, a=NOISE[:127, :254])], "--autocorrelation"),
        (lambda f, c: ["--autocorrelation", c], "a folder"),
        (lambda f, c: [c, "--distance-m", "-1"], "--distance-m"),
        (lambda f, c: [c, "--truth", f / "none.npy"], "--truth"),
        (lambda f, c: ["--autocorrelation", c / "truth.npy"], "127 x 127"),
        (lambda f, c: [c, "--method", "magic"], "magic"),
    ],
)
def test_bad_frames_are_one_line(tmp_path, capture, command, arguments, words):
    code, out, err = command(invert, *arguments(tmp_path, capture), "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err
    assert not list(tmp_path.glob("out/*"))


def test_an_unwritable_output_folder_is_one_line(capture, tmp_path, command):
    (tmp_path / "file").write_text("in the way")
    code, _, err = command(invert, capture, "-o", tmp_path / "file")
    assert code == 2
    assert "output folder" in err


def test_missing_libllvm_is_one_line_and_inverting_works_without_it(capture, tmp_path):
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so", "CUDA_VISIBLE_DEVICES": ""}
    run = subprocess.run(
        [sys.executable, "-m", "sim", str(SCENE), "--plan"], env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert "libllvm" in run.stderr
    run = subprocess.run(
        [sys.executable, "-m", "invert", str(capture), "-o", str(tmp_path), "--quality", "fast"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0


def test_the_doctor_tells_what_is_there_and_what_a_missing_libllvm_costs():
    command = [sys.executable, "-c", "from correlograph.doctor import main; main([])"]
    healthy = subprocess.run(command, capture_output=True, text=True, check=False)
    assert healthy.returncode == 0, healthy.stdout + healthy.stderr
    for piece in ("Python", "packages", "libLLVM", "Mitsuba", "GPU", "threads", "weights"):
        assert any(line.startswith(piece) for line in healthy.stdout.splitlines()), piece
    lacking = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}
    )
    assert lacking.returncode == 1
    assert "rendering does not" in lacking.stdout
    assert "Traceback" not in lacking.stdout + lacking.stderr
