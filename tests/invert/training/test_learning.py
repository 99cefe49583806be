"""Features, losses, networks, weights; the shipped network on noise and on an F."""

import hashlib
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from correlograph.errors import InputError
from correlograph.lags import LAGS, lag_grid
from invert.albedo.metrics import aligned_pearson
from invert.choices import BALANCED, DEFAULT_WEIGHTS, UNET, quality_named
from invert.measure.spectrum import read_measurement
from invert.methods import reconstructor
from invert.network.checkpoints import load_network, read_weights, save_weights, untrained_parts
from invert.network.features import (
    FUSION_CHANNELS,
    LAG_CHANNELS,
    PICTURES,
    SKETCH_CHANNELS,
    Observation,
    half_plane,
    lag_features,
    modulus_picture,
    paper_picture,
    picture_features,
    sketch_features,
    whole_plane,
)
from invert.network.inference import AUGMENTATIONS, predict
from invert.network.model import CorrelographyNet
from invert.network.paper_unet import PaperModulusUnet, PaperUnet
from invert.training.data import at_noise, make_varied_batch, paper_noise
from invert.training.losses import LOSSES, noise_left, registered_pearson
from radiometry.autocorrelation import autocorrelate

HALF_PLANE = lag_grid(LAGS).half_plane
RING = lag_grid(LAGS).ring


def torch_rng(seed: int = 3) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def objects() -> torch.Tensor:
    """Lopsided objects, uint8 (6, 64, 64)."""
    rng = np.random.default_rng(4)
    pictures = np.zeros((6, 64, 64), np.uint8)
    for picture in pictures:
        for _ in range(3):
            row, column = rng.integers(14, 40, 2)
            height, width = rng.integers(3, 14, 2)
            picture[row : row + height, column : column + width] = rng.integers(100, 256)
    return torch.from_numpy(pictures)


@pytest.fixture
def observation(objects) -> Observation:
    return at_noise(objects.float() / 255.0, 0.3, 64.0, torch_rng()).seen


def lags_seen(seen: Observation) -> torch.Tensor:
    return lag_features(seen)[0]


def test_features_know_no_unit_and_never_see_zero_lag(observation):
    observation = replace(observation, denoised=0.5 * observation.values)
    for features, shape in (
        (picture_features, (FUSION_CHANNELS, 32, 32)),
        (sketch_features, (SKETCH_CHANNELS, 32, 32)),
        (lags_seen, (LAG_CHANNELS, 64, 32)),
    ):
        reference = features(observation)
        assert reference.shape == (6, *shape)
        scaled = replace(observation, **{name: getattr(observation, name) * 1e-9 for name in ("values", "floor", "denoised")})
        torch.testing.assert_close(features(scaled), reference, rtol=1e-3, atol=1e-4)
        struck = observation.values.clone()
        struck[:, 63, 63] = 1e6
        torch.testing.assert_close(features(replace(observation, values=struck)), reference)
        empty = Observation.from_estimate(torch.zeros(1, 127, 127), torch.zeros(1), torch.ones(1))
        assert torch.isfinite(features(empty)).all()
    torch.testing.assert_close(paper_picture(struck), paper_picture(observation.values))


def test_half_a_plane_is_the_whole(observation):
    lags = observation.values
    half = half_plane(lags)
    assert half.shape == (6, 128, 64)
    torch.testing.assert_close(half[:, 64 + 5, 7], lags[:, 63 + 5, 63 + 7])
    torch.testing.assert_close(whole_plane(half), lags)
    shown, _, _ = lag_features(observation)
    # Beside lag (v, h) stands (-v, h): the third map is the first one upside down.
    maps = torch.nn.functional.pixel_shuffle(shown[:, :16], 2)
    torch.testing.assert_close(maps[:, 2, 64 + 9, 12], maps[:, 0, 64 - 9, 12])


def test_denoiser_returns_an_autocorrelation_in_estimate_units(observation):
    torch.manual_seed(0)
    denoiser = CorrelographyNet(16).denoiser.eval()
    with torch.no_grad():
        signal = denoiser(observation)
        scaled = denoiser(replace(observation, values=observation.values * 1e-6, floor=observation.floor * 1e-6))
    torch.testing.assert_close(signal, signal.flip((-2, -1)))
    torch.testing.assert_close(1e6 * scaled, signal, rtol=1e-3, atol=1e-3)


def test_noise_left_is_the_share_that_is_left(objects):
    batch = at_noise(objects.float() / 255.0, 0.3, 64.0, torch_rng())
    measured = batch.seen.values - 0.3
    halved = batch.signal + 0.5 * (measured - batch.signal)
    halved[:, 63, 63] = batch.signal[:, 63, 63]  # zero lag is never measured
    np.testing.assert_allclose(noise_left(measured, batch.signal, measured).exp(), 1.0, atol=0.1)
    np.testing.assert_allclose(noise_left(halved, batch.signal, measured).exp(), 0.5, atol=0.1)
    assert float(noise_left(batch.signal, batch.signal, measured).exp().max()) < 0.02
    nothing = torch.zeros_like(measured)
    assert torch.isfinite(noise_left(nothing, nothing, measured)).all()


def test_the_fusion_keeps_a_good_classical_picture(objects, observation):
    """Untrained, the fusion adds what it is shown, laid over the sketch, in whichever turn and place it came."""
    torch.manual_seed(0)
    network = CorrelographyNet(32).eval()
    truth = objects.float() / 255.0
    shown = torch.roll(truth.flip((-2, -1)), (5, 3), (-2, -1))
    with torch.no_grad():
        albedo, _ = predict(network, replace(observation, classical=shown[:, None].expand(-1, PICTURES, -1, -1)))
    assert float(registered_pearson(albedo, truth).min()) > 0.5


@pytest.mark.parametrize("name", LOSSES)
def test_losses_do_not_feel_shift_turn_or_brightness(objects, name):
    truth = objects.float() / 255.0
    moved = 3.0 * torch.roll(truth.flip((-2, -1)), (4, -7), (-2, -1))
    other = truth.roll(1, 0)
    assert float(LOSSES[name](moved, truth).max()) < 0.02
    assert float(LOSSES[name](other, truth).min()) > 0.02
    guess = torch.rand(6, 64, 64, generator=torch_rng()).requires_grad_(True)
    LOSSES[name](guess, truth).sum().backward()
    assert torch.isfinite(guess.grad).all()
    assert guess.grad.abs().amax((-2, -1)).min() > 0.0


def test_registered_pearson_is_the_metric(objects):
    truth = objects.float() / 255.0
    guess = torch.roll(truth.flip((-2, -1)), (2, 3), (-2, -1)) + 0.2 * torch.rand(6, 64, 64, generator=torch_rng())
    guess[:, :8], guess[:, -8:] = 0.0, 0.0
    ours = registered_pearson(guess, truth)
    theirs = [aligned_pearson(a.numpy(), b.numpy())[0] for a, b in zip(guess, truth, strict=True)]
    np.testing.assert_allclose(ours, theirs, atol=0.02)


def test_the_registered_loss_is_not_deceived(objects):
    """A bright point beside a faint copy: nearly the right autocorrelation, and a wrong object."""
    truth = objects[:1].float() / 255.0
    deceiver = 0.02 * truth.clone()
    deceiver[0, 2, 2] = float(0.02 * truth.sum()) * 2.0
    wrong = torch.rand(1, 64, 64, generator=torch_rng())
    assert LOSSES["pearson"](deceiver, truth)[0] < LOSSES["pearson"](wrong, truth)[0] + 0.5
    assert LOSSES["registered"](deceiver, truth)[0] > 0.7


def test_batches_depend_on_the_seed_alone(objects):
    first, second = (make_varied_batch(objects, 40, torch_rng(9)) for _ in range(2))
    torch.testing.assert_close(first.seen.values, second.seen.values, rtol=0, atol=0)
    estimate = first.seen.values
    torch.testing.assert_close(estimate, estimate.flip((-2, -1)), rtol=1e-5, atol=1e-6)
    assert (first.truth.amax((-2, -1)) == 0.0).sum() <= 8
    outer = estimate[:, torch.from_numpy(RING > LAGS - 8)]
    np.testing.assert_allclose(np.median(outer.mean(1) / first.seen.floor), 1.0, atol=0.1)
    paper = paper_noise(objects, 200, torch_rng()).seen
    corner = paper.values[:, :20, :20]
    assert float(corner.mean()) * 255 == pytest.approx(70.0, rel=0.03)
    assert float(corner.var() / corner.mean() ** 2) == pytest.approx(0.015, rel=0.1)


@pytest.mark.parametrize("kind", [CorrelographyNet, PaperUnet, PaperModulusUnet])
def test_networks_draw_albedos(observation, kind):
    torch.manual_seed(0)
    network = kind(32).eval()
    with torch.no_grad():
        albedo, expected = predict(network, observation)
    assert albedo.shape == (6, 64, 64)
    assert expected.shape == (6,)
    assert float(albedo.min()) >= 0.0
    for index in (0, 3):  # independent of the rest of the batch, up to the rounding of bfloat16
        with torch.no_grad():
            alone, _ = predict(network, observation.part(slice(index, index + 1), "cpu"))
        torch.testing.assert_close(alone[0], albedo[index], rtol=0.05, atol=0.02)


def test_the_papers_network_is_the_papers():
    network = PaperUnet(64)
    layers = [module for module in network.modules() if isinstance(module, torch.nn.Conv2d)]
    assert len(layers) == 12
    assert {layer.out_channels for layer in layers[:-1]} == {64, 128, 256, 512}


def test_modulus_image_is_the_spectrum_of_the_object(objects):
    truth = objects.float() / 255.0
    lags = torch.stack([torch.from_numpy(autocorrelate(one.numpy())) for one in truth]).float()
    lags[:, 63, 63] = 0.0  # never seen
    picture = modulus_picture(lags + 3.0, torch.full((6,), 3.0))
    spectrum = torch.fft.fftshift(torch.fft.fft2(truth, s=(128, 128)).abs(), (-2, -1))[:, None]
    together = torch.stack((picture.flatten(), (spectrum / spectrum.amax((-2, -1), keepdim=True)).flatten()))
    assert float(torch.corrcoef(together)[0, 1]) > 0.98


def test_poses_are_undone(objects):
    for transform, inverse in AUGMENTATIONS:
        torch.testing.assert_close(inverse(transform(objects)), objects)


def test_weights_keep_their_card_and_refuse_what_is_not_theirs(tmp_path):
    torch.manual_seed(0)
    state = CorrelographyNet(32).state_dict()
    path = tmp_path / "w.safetensors"
    save_weights(path, state, {"network": "unet", "width": 32})
    network, card = load_network(path)
    assert card["width"] == 32
    torch.testing.assert_close(network.state_dict()["denoiser.unet.stem.weight"], state["denoiser.unet.stem.weight"])
    (tmp_path / "torn.safetensors").write_bytes(path.read_bytes()[:5000])
    content = bytearray(path.read_bytes())
    content[-7] ^= 1
    (tmp_path / "changed.safetensors").write_bytes(content)
    (tmp_path / "pickle.safetensors").write_bytes(pickle.dumps({"weights": [1.0]}))
    torch.save(state, tmp_path / "torch.safetensors")
    save_weights(tmp_path / "other.safetensors", state, {"network": "unet", "width": 64})
    save_weights(tmp_path / "kind.safetensors", state, {"network": "oracle", "width": 32})
    name = "fusion.judge.0.bias"
    save_weights(tmp_path / "nan.safetensors", {**state, name: state[name] * float("nan")}, {"network": "unet", "width": 32})
    bad = ({"fast": [1.0, 2.0]}, {"sizes": {"width": [2.0, 1.0]}}, {"balanced": "high"}, [1.0], {"sizes": {"area": [None]}})
    for number, calibration in enumerate(bad):
        save_weights(
            tmp_path / f"calibration {number}.safetensors", state, {"network": "unet", "width": 32, "calibration": calibration}
        )
    refused = {
        "torn": "invert.train",
        "changed": "invert.train",
        "pickle": "invert.train",
        "torch": "invert.train",
        "absent": "no ",
        "other": "of this version",
        "kind": "oracle",
        "nan": "NaN",
        **{f"calibration {number}": "calibrate again" for number in range(len(bad))},
    }
    for name, text in refused.items():
        with pytest.raises(InputError, match=text):
            load_network(tmp_path / f"{name}.safetensors")


needs_weights = pytest.mark.skipif(not DEFAULT_WEIGHTS.is_file(), reason="no weights are shipped")


@needs_weights
def test_shipped_weights_are_small_and_say_where_they_come_from():
    assert DEFAULT_WEIGHTS.stat().st_size < 20e6
    network, card = load_network(DEFAULT_WEIGHTS)
    assert isinstance(network, CorrelographyNet)
    assert {"run", "dataset", "validation", "seconds"} <= set(card)
    described = DEFAULT_WEIGHTS.with_suffix(".md").read_text()
    assert hashlib.sha256(DEFAULT_WEIGHTS.read_bytes()).hexdigest() in described


def noise(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Estimates of nothing: white, with lines of read noise, on sloping floors."""
    floor = np.ones((127, 127))
    radius = np.hypot(*np.mgrid[-63:64, -63:64]) / 63.0
    if kind == "slope":
        floor += rng.uniform(-0.2, 0.2) * radius**2
    dof = float(np.exp(rng.uniform(np.log(8.0), np.log(1000.0))))
    estimate = floor * rng.gamma(dof, 1.0 / dof, floor.shape)
    estimate = np.where(HALF_PLANE, estimate, estimate[::-1, ::-1])
    if kind == "lines":
        line = 1.0 + rng.uniform(0.0, 4.0) * rng.gamma(8.0, 1.0 / 8.0, 127)
        estimate[63] *= 0.5 * (line + line[::-1])
    return estimate.astype(np.float32)


@needs_weights
@pytest.mark.parametrize("kind", ["white", "lines", "slope"])
@pytest.mark.parametrize(("quality", "count"), [("fast", 200), ("balanced", 40)])
def test_noise_is_no_object(rng, kind, quality, count):
    """False alarms below 1 %: the signal must stand out of a floor that slopes, and the network must believe its picture."""
    estimates = (read_measurement(noise(rng, kind)) for _ in range(count))
    assert sum(reconstructor(UNET, quality_named(quality)).run(estimate).object_found for estimate in estimates) <= 0.01 * count


@pytest.mark.slow
@needs_weights
def test_the_network_draws_an_f_that_is_not_mirrored(rng):
    image = np.zeros((64, 64), np.float32)
    image[14:48, 20:25], image[14:19, 20:42], image[28:33, 20:37] = 1.0, 1.0, 1.0
    batch = at_noise(torch.from_numpy(image)[None], 80.0 / 255.0, 64.0, torch_rng())
    measurement = read_measurement(batch.seen.values[0].numpy())
    for quality, wanted in (("fast", 0.7), ("balanced", 0.85)):
        result = reconstructor(UNET, quality_named(quality)).run(measurement)
        pearson, _ = aligned_pearson(result.albedo, image)
        assert result.object_found
        assert pearson > wanted
        assert aligned_pearson(result.albedo[:, ::-1], image)[0] < pearson
        assert abs(result.confidence - pearson) < 0.2
    twice = reconstructor(UNET, BALANCED).run(measurement)
    np.testing.assert_array_equal(twice.albedo, result.albedo)


def test_parts_without_training_are_named():
    denoiser = {"network": "unet", "run": {"part": "denoiser", "start_from": None}}
    sketch = {"network": "unet", "run": {"part": "sketch", "start_from": denoiser}}
    assert untrained_parts(denoiser) == ["sketch", "fusion", "sampler"]
    assert untrained_parts(sketch) == ["fusion", "sampler"]
    assert untrained_parts({"network": "paper", "run": {}}) == []
    assert untrained_parts(read_weights(DEFAULT_WEIGHTS)[1]) == []
