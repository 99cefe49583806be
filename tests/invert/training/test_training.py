"""The training loop: exact resumption, warm starts, bad arguments."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from invert.network.checkpoints import read_weights
from invert.training.train import main as train


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    from data_gen.__main__ import main

    store = tmp_path_factory.mktemp("targets") / "set.zarr"
    main([str(store), "--source", "strokes", "--count", "1600", "--workers", "1"])
    return store


def arguments(dataset: Path, output: Path) -> list[str]:
    return [str(dataset), "-o", str(output), "--width", "32", "--steps", "12", "--batch", "4", "--checkpoint-every", "4"]


@pytest.mark.slow
@pytest.mark.parametrize("part", ["denoiser", "sampler"])
def test_training_resumes_exactly_after_a_kill(tmp_path, dataset, part):
    whole, killed = tmp_path / "whole.safetensors", tmp_path / "killed.safetensors"
    train([*arguments(dataset, whole), "--part", part])
    process = subprocess.Popen(
        [sys.executable, "-m", "invert.train", *arguments(dataset, killed), "--part", part],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    checkpoint = tmp_path / "killed.checkpoint.safetensors"
    while not checkpoint.is_file() and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not killed.is_file()
    assert read_weights(checkpoint)[1]["step"] in (4, 8)
    train([*arguments(dataset, killed), "--part", part, "--workers", "2"])  # which draw the same batches
    expected, found = read_weights(whole)[0], read_weights(killed)[0]
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, rtol=0, atol=0)
    card = json.loads((tmp_path / "killed.json").read_text())
    assert card["run"]["steps"] == 12
    assert [point["step"] for point in card["curve"]] == [4, 8, 12]
    assert (tmp_path / "killed.png").stat().st_size > 3000


@pytest.mark.slow
def test_training_learns_and_warm_starts_are_used(tmp_path, dataset, command):
    from invert.network.features import PICTURES
    from invert.training.warm_starts import load_warm_starts
    from invert.training.warm_starts import main as warm_starts

    store, output = tmp_path / "warm.zarr", tmp_path / "w.safetensors"
    base = [dataset, "-o", output, "--width", 32, "--steps", 60, "--batch", 8, "--checkpoint-every", 5]
    code, _, err = command(train, *base)
    assert code == 0, err
    curve = json.loads((tmp_path / "w.json").read_text())["curve"]
    assert curve[-1]["loss"] < curve[0]["loss"] - 0.3
    assert curve[-1]["validation"][1] < 0.8  # of the noise at b 80, K 64
    code, _, err = command(train, *base, "--steps", 70)
    assert code == 2
    assert "checkpoint" in err
    assert command(warm_starts, dataset, "--weights", output, "-o", store, "--count", 32)[0] == 0
    assert command(warm_starts, dataset, "--weights", output, "-o", store, "--count", 64)[0] == 2
    pictures = load_warm_starts([str(store)])["classical"]
    assert pictures.shape == (32, PICTURES, 64, 64)
    shown = pictures[(pictures > 0).flatten(1).any(1)]
    # All starts, and one of them: the same where none of the others agrees with it.
    assert float((shown[:, 0] == shown[:, 1]).flatten(1).all(1).float().mean()) < 0.2
    again = tmp_path / "again.safetensors"
    for part, extra in (("sketch", []), ("sampler", []), ("fusion", ["--warm", store])):
        code, _, err = command(
            train,
            dataset,
            "-o",
            again,
            "--width",
            32,
            "--steps",
            2,
            "--batch",
            4,
            "--start-from",
            output,
            "--part",
            part,
            *extra,
        )
        assert code == 0, err
        tensors, card = read_weights(again)
        assert card["run"]["start_from"]["run"]["steps"] == 60
        earlier, _ = read_weights(output)
        for name, value in earlier.items():  # one part learns, the others stay
            assert torch.equal(tensors[name], value) or name.startswith(f"{part}.")
        assert not torch.equal(tensors[f"{part}.unet.stem.weight"], earlier[f"{part}.unet.stem.weight"])
        again.with_suffix(".checkpoint.safetensors").unlink()


@pytest.fixture(scope="module")
def wider_dataset(tmp_path_factory) -> Path:
    from data_gen.__main__ import main

    store = tmp_path_factory.mktemp("targets") / "wider.zarr"
    main([str(store), "--source", "pages", "--count", "1600", "--workers", "1", "--lags", "71"])
    return store


@pytest.mark.slow
@pytest.mark.parametrize(
    "chosen",
    [["--network", "paper"], ["--network", "paper-modulus"], *(["--part", part] for part in ("denoiser", "sketch", "sampler"))],
)
def test_every_network_trains_to_the_end(tmp_path, dataset, wider_dataset, chosen):
    """The parts of the default network train on two numbers of lags in turn."""
    stores = [dataset] if "--network" in chosen else [dataset, wider_dataset]
    output = tmp_path / "w.safetensors"
    train([*map(str, stores), "-o", str(output), "--width", "8", "--steps", "2", "--batch", "4", *chosen])
    assert read_weights(output)[1]["validation"]
    assert len(json.loads(output.with_suffix(".json").read_text())["validation"]) == 5 * len(stores)


def test_bad_training_arguments(tmp_path, command):
    for extra, text in (
        (["--steps", 0], "--steps"),
        (["--width", 20], "--width"),
        (["--part", "sampler", "--batch", 1], "--batch"),
        ([], "none at"),
    ):
        code, _, err = command(train, tmp_path / "none.zarr", "-o", tmp_path / "w.safetensors", *extra)
        assert code == 2
        assert text in err
    assert command(train, tmp_path, "-o", tmp_path / "w.pt")[0] == 2
