"""Training data of the despeckler: closed forms of the speckle; and the network: any size, any unit, better than total variation."""

import numpy as np
import pytest
import torch

from correlograph.errors import InputError
from data_gen.letters import letter
from invert.__main__ import main as invert
from invert.field.despeckling import despeckle
from invert.field.total_variation import smooth_by_total_variation
from invert.network.checkpoints import DESPECKLER_WEIGHTS, load_network
from invert.network.despeckler import Despeckler
from invert.training import speckle
from invert.training.speckle import SIDE, draw_speckled, speckled_at
from invert.training.train import main as train
from tests.radiometry.test_ring_correlation import fields


def generator(seed=1):
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def uniform(monkeypatch):
    """Targets of uniform albedo without shading, lit uniformly."""
    for name in ("SHADED_SHARE", "SHARP_SHARE", "LIT_SHARE"):
        monkeypatch.setattr(speckle, name, 0.0)
    monkeypatch.setattr(speckle, "ZOOM", (8.0, 10.0))
    return torch.full((20, 64, 64), 255, dtype=torch.uint8)


@pytest.mark.parametrize("looks", [1, 4, 9])
def test_the_mean_of_looks_has_the_contrast_of_gamma_variables(uniform, looks):
    drawn = speckled_at(uniform, 8, looks, torch.inf, generator())
    inside = drawn.truth > 0.99 * drawn.truth.amax((-2, -1), keepdim=True)
    seen = (drawn.intensity / drawn.truth.clamp_min(1e-6))[inside]
    assert float(seen.mean()) == pytest.approx(1.0, rel=0.05)
    assert float(seen.std()) == pytest.approx(looks**-0.5, rel=0.07)


def test_the_speckle_of_the_illumination_adds_contrast(uniform, monkeypatch):
    """Two patterns multiply: the second moment of the intensity is 4 instead of 2 where the grain is wide."""
    monkeypatch.setattr(speckle, "LIT_SHARE", 1.0)
    monkeypatch.setattr(speckle, "GRAIN", (4.0, 5.0))
    drawn = speckled_at(uniform, 16, 1, torch.inf, generator())
    inside = drawn.truth > 0.99 * drawn.truth.amax((-2, -1), keepdim=True)
    seen = (drawn.intensity / drawn.truth.clamp_min(1e-6))[inside]
    assert float(seen.square().mean() / seen.mean() ** 2) == pytest.approx(4.0, rel=0.25)


def test_batches_depend_on_the_seed_only_and_are_finite():
    targets = torch.from_numpy(np.random.default_rng(2).integers(0, 256, (30, 64, 64)).astype(np.uint8))
    first, again = (draw_speckled(targets, 12, generator(5)) for _ in range(2))
    assert first.intensity.shape == first.truth.shape == (12, SIDE, SIDE)
    for one, other in zip(vars(first).values(), vars(again).values(), strict=True):
        assert torch.equal(one, other)
        assert torch.isfinite(one).all()
    assert not torch.equal(first.truth, draw_speckled(targets, 12, generator(6)).truth)


@pytest.mark.parametrize("shape", [(16, 16), (37, 91), (130, 75)])
def test_the_network_accepts_any_size_and_unit(rng, shape):
    network, _ = load_network(DESPECKLER_WEIGHTS, kinds=("despeckler",))
    seen, looks = torch.from_numpy(rng.exponential(1.0, (2, *shape))).float(), torch.tensor([1.0, 3.0])
    with torch.inference_mode():
        found, scaled = network(seen, looks), network(1e6 * seen, looks)
        dark = network(torch.zeros_like(seen), looks)
    assert found.shape == seen.shape
    assert found.min() >= 0.0
    torch.testing.assert_close(scaled, 1e6 * found, rtol=1e-3, atol=1.0)
    assert torch.isfinite(dark).all()


@pytest.mark.parametrize(("character", "looks"), [("G", 1), ("4", 2), ("k", 4)])
def test_the_shipped_network_beats_total_variation_on_characters_it_has_not_seen(rng, character, looks):
    """Latin characters are not among its targets; the fields are those of another generator."""
    truth = np.pad(letter(character)[::2, ::2] / 255.0, ((8, 16), (24, 8)))
    frames = torch.from_numpy(np.stack([np.abs(field[None]) ** 2 for field in fields(truth, 1.5, looks, rng)])).float()
    network, _ = load_network(DESPECKLER_WEIGHTS, kinds=("despeckler",))
    mean = frames.mean((0, 1))
    with torch.inference_mode():
        found = network(mean[None], torch.tensor([float(looks)]))[0]
    errors = [float((one - torch.from_numpy(truth)).square().sum()) for one in (found, *map_weights(mean, looks))]
    assert errors[0] < min(errors[1:])
    if looks > 1:
        assert despeckle(frames).weight is None


def map_weights(mean, looks):
    return [smooth_by_total_variation(mean, looks, weight) for weight in (1.0, 2.0, 4.0)]


@pytest.mark.slow
def test_training_ends_with_weights_that_load_and_only_despeckle(tmp_path, command):
    targets = tmp_path / "set.zarr"
    from data_gen.__main__ import main as data_gen

    assert command(data_gen, targets, "--source", "shapes", "--count", "640")[0] == 0
    file = tmp_path / "w.safetensors"
    code, _, _ = command(train, targets, "-o", file, "--network", "despeckler", "--width", "8", "--steps", "2", "--batch", "8")
    assert code == 0
    network, card = load_network(file, kinds=("despeckler",))
    assert isinstance(network, Despeckler)
    assert card["network"] == "despeckler"
    np.save(tmp_path / "frame.npy", np.random.default_rng(1).exponential(1.0, (300, 300)).astype(np.float32))
    code, _, error = command(invert, tmp_path / "frame.npy", "-o", tmp_path / "out", "--weights", file)
    assert code == 2
    assert "--weights" in error
    with pytest.raises(InputError, match="despeckler"):
        load_network(file)
