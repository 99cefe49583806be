"""Generated input for every command: refused in one line, or finite and sensible.

`make fuzz` generates many more (FUZZ_EXAMPLES per test, different in each run); the short run repeats the same examples.
"""

import json
import os
import shutil
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("mitsuba")

import invert
from correlograph.commands.light_budget import main as radiometry
from correlograph.errors import InputError
from data_gen.__main__ import main as data_gen
from data_gen.dataset import load_targets
from data_gen.preview import main as preview
from invert.choices import DEFAULT_WEIGHTS
from invert.network.checkpoints import load_network
from invert.training.train import main as train
from scenes import scene_path
from sim.__main__ import main as sim
from tests.light import speckle

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "0"))
SCENES = ("corner_letter", "two_depths", "strong_ambient")

pytestmark = pytest.mark.slow


def drawn(count: int):
    """So many examples in the short run, the same each time."""
    return settings(
        max_examples=EXAMPLES or count,
        derandomize=not EXAMPLES,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )


numbers = st.one_of(st.floats(), st.floats(1e-9, 1e3), st.sampled_from([0.0, -1.0, 1e-300, 1e300, 5e-7, 1.0, 2.0**31]))
words = st.one_of(numbers.map(repr), st.text(max_size=12), st.sampled_from(["", "nan", "1e400", "R.png", "../F.png", "0x10"]))


def is_one_line(error: InputError) -> bool:
    return "\n" not in str(error) and len(str(error)) < 900


def refused(code: int, err: str) -> bool:
    """Whether a command refused; what it then says is one line."""
    assert code in (0, 2)
    assert "Traceback" not in err
    if code:
        assert err.startswith("error: "), err
        assert err.count("\n") == 1, err
        assert len(err) < 900, err
    return bool(code)


def finite(content: object) -> bool:
    """No number of a JSON content is NaN or infinite."""
    if isinstance(content, dict):
        return all(map(finite, content.values()))
    if isinstance(content, list):
        return all(map(finite, content))
    return not isinstance(content, float) or np.isfinite(content)


@drawn(30)
@given(
    name=st.sampled_from(["exposure", "standoff", "power", "albedo", "nonsense"]),
    value=words,
    frames=st.integers(-1, 5),
    tolerance=st.sampled_from(["1e-2", "1", "1e-9", "0", "nan", "-1", "1e99"]),
    accuracy=st.sampled_from(["statistical", "field"]),
)
def test_parameters_of_a_scene(command, name, value, frames, tolerance, accuracy):
    code, out, err = command(
        sim,
        scene_path("corner_letter"),
        "--plan",
        "--json",
        "-D",
        f"{name}={value}",
        "--frames",
        frames,
        "--tolerance",
        tolerance,
        "--accuracy",
        accuracy,
    )
    if not refused(code, err):
        assert finite(json.loads(out))


@drawn(40)
@given(scene=st.sampled_from(SCENES), place=st.integers(0, 500), value=numbers, mode=st.sampled_from(["plan", "account"]))
def test_a_number_of_a_scene_file(command, tmp_path, scene, place, value, mode):
    """Any number in the file, one at a time: another size, or none at all."""
    path = scene_path(scene)
    tree = ElementTree.parse(path)
    places = [
        (node, key)
        for node in tree.iter()
        for key in ("value", "x", "y", "z", "angle")
        if node.tag not in ("default", "string") and _is_number(node.get(key))
    ]
    node, key = places[place % len(places)]
    node.set(key, repr(value))
    folder = tmp_path / scene
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(path.parent, folder)
    tree.write(folder / "scene.xml")
    shared = folder.parent / "corner_letter"
    if not shared.exists():
        shutil.copytree(scene_path("corner_letter").parent, shared)
    if mode == "plan":
        code, out, err = command(sim, folder / "scene.xml", "--plan", "--json")
    else:
        code, out, err = command(radiometry, folder / "scene.xml", "--json", "--samples", 4096)
    if not refused(code, err):
        assert finite(json.loads(out))


def _is_number(text: str | None) -> bool:
    try:
        float(text or "")
    except ValueError:
        return False
    return True


def speckle_of_a_bar(shape: tuple[int, int, int], rng: np.random.Generator) -> np.ndarray:
    bar = np.ones((shape[1] // 5, shape[2] // 20))
    return np.stack([rng.poisson(3.0 * speckle(bar, shape[1:], rng)) for _ in range(shape[0])]).astype(np.float64)


def frames_of(kind: str, shape: tuple[int, int, int], scale: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    frames = {
        "poisson": lambda: rng.poisson(0.5, shape).astype(np.float64),
        "uniform": lambda: rng.random(shape),
        "gradient": lambda: np.broadcast_to(np.linspace(0.0, 1.0, shape[2]), shape).copy(),
        "stripes": lambda: np.broadcast_to(np.sin(0.3 * np.arange(shape[1]))[:, None], shape) + rng.random(shape),
        "spots": lambda: (rng.random(shape) < 1e-4).astype(np.float64),
        "zeros": lambda: np.zeros(shape),
        "holes": lambda: np.where(rng.random(shape) < 1e-3, np.nan, rng.random(shape)),
        "speckle": lambda: rng.gamma(1.0, 1.0, shape),
        "object": lambda: speckle_of_a_bar(shape, rng),
    }[kind]()
    return frames * scale


KINDS = ("poisson", "uniform", "gradient", "stripes", "spots", "zeros", "holes", "speckle", "object")
SIDES = (520, 401, 263, 127, 100)


@drawn(40)
@given(
    kind=st.sampled_from(KINDS),
    count=st.integers(1, 3),
    height=st.sampled_from(SIDES),
    width=st.sampled_from(SIDES),
    scale=st.sampled_from([1.0, 3e-7, 1e8, 0.02, 1e-12, 1e30, -1.0]),
    patch=st.sampled_from([127, 131, 200, 64, 400, None]),
    dtype=st.sampled_from(["f4", "f8", "u2", "i4"]),
    method=st.sampled_from(["classical", "hio", "unet"]),
    mean=st.sampled_from(["auto", "pooled", "fixed", "published"]),
    seed=st.integers(0, 99),
)
def test_frames(kind, count, height, width, scale, patch, dtype, method, mean, seed):
    with np.errstate(invalid="ignore", over="ignore"):
        frames = frames_of(kind, (count, height, width), scale, seed).astype(dtype)
    try:
        result = invert.reconstruct(frames, method=method, quality="fast", patch=patch, mean_model=mean, seed=seed)
    except InputError as error:
        assert is_one_line(error)  # noqa: PT017 - not every example is refused
        return
    assert np.isfinite(result.albedo).all()
    assert result.albedo.min() >= 0.0
    assert 0.0 <= result.confidence <= 1.0
    assert np.isfinite(result.estimate.values).all()


@drawn(30)
@given(
    kind=st.sampled_from(["noise", "blob", "delta", "flat", "zeros", "steep", "negative"]),
    scale=st.floats(1e-20, 1e20),
    floor=st.floats(0.0, 10.0),
    method=st.sampled_from(["classical", "unet", "raar"]),
    seed=st.integers(0, 99),
)
def test_estimates(kind, scale, floor, method, seed):
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[-63:64, -63:64]
    lags = {
        "noise": lambda: rng.gamma(64.0, 1.0 / 64.0, (127, 127)),
        "blob": lambda: np.exp(-(row**2 + 2 * column**2) / 200.0),
        "delta": lambda: (row == 0) * (column == 0) * 1.0,
        "flat": lambda: np.ones((127, 127)),
        "zeros": lambda: np.zeros((127, 127)),
        "steep": lambda: 1e-8 ** (np.hypot(row, column) / 90.0),
        "negative": lambda: rng.standard_normal((127, 127)),
    }[kind]()
    lags = ((0.5 * (lags + lags[::-1, ::-1]) + floor) * scale).astype(np.float32)
    try:
        result = invert.reconstruct(lags, method=method, quality="fast", seed=seed)
    except InputError as error:
        assert is_one_line(error)  # noqa: PT017 - not every example is refused
        return
    assert np.isfinite(result.albedo).all()
    assert 0.0 <= result.confidence <= 1.0


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    store = tmp_path_factory.mktemp("set") / "set.zarr"
    data_gen([str(store), "--source", "shapes", "--count", "600", "--workers", "1"])
    return store


@drawn(60)
@given(place=st.integers(0, 10**6), offset=st.floats(0.0, 1.0), how=st.sampled_from(["cut", "flip", "remove", "empty", "text"]))
def test_a_damaged_store_is_refused_or_whole(dataset, tmp_path, command, place, offset, how):
    copy = tmp_path / "copy.zarr"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(dataset, copy)
    files = sorted(path for path in copy.rglob("*") if path.is_file())
    file = files[place % len(files)]
    held = file.read_bytes()
    middle = int(offset * max(len(held) - 1, 0))
    changed = {
        "cut": held[:middle],
        "flip": held[:middle] + bytes([held[middle] ^ 0x55]) + held[middle + 1 :],
        "remove": b"",
        "empty": b"",
        "text": b'{"zarr_format": 3}',
    }[how]
    file.unlink() if how == "remove" else file.write_bytes(changed)
    try:
        kept = load_targets(str(copy))
    except InputError as error:
        assert is_one_line(error)  # noqa: PT017 - not every example is refused
    else:
        for ours, whole in zip(kept, load_targets(str(dataset)), strict=True):
            assert (ours == whole).all()
    refused(*command(preview, copy, "-o", tmp_path / "sheet.png")[::2])


@drawn(40)
@given(
    count=st.one_of(st.integers(-5, 10**30), st.integers(1, 500)),
    source=st.sampled_from(["glyphs", "strokes", "?"]),
    low=words,
    high=words,
    workers=st.integers(-2, 10**6),
    measurement=st.sampled_from(["none", "noise-model", "render"]),
)
def test_options_of_data_gen(command, tmp_path, count, source, low, high, workers, measurement):
    levels = ("--floor-over-peak", low, high) if measurement == "noise-model" else ()
    code, out, err = command(
        data_gen,
        tmp_path / "a.zarr",
        "--source",
        source,
        "--count",
        count,
        "--workers",
        workers,
        "--measurement",
        measurement,
        *levels,
        "--dry-run",
    )
    assert not (tmp_path / "a.zarr").exists()
    if not refused(code, err):
        assert "samples" in out or "targets" in out or "pairs" in out


@drawn(40)
@given(name=st.sampled_from(["--steps", "--batch", "--width", "--learning-rate", "--seed", "--checkpoint-every"]), value=words)
def test_options_of_training(command, tmp_path, dataset, name, value):
    """None of these values lets a training begin that could not go on."""
    short = {"--steps": 1, "--batch": 2, "--width": 8}
    short.pop(name, None)
    arguments = [part for pair in short.items() for part in pair]
    if name in ("--steps", "--checkpoint-every") or (name == "--batch" and value.isdigit() and int(value) < 1000):
        value = f"-{value}"
    code, _, err = command(train, dataset, "-o", tmp_path / "w.safetensors", *arguments, f"{name}={value}")
    (tmp_path / "w.checkpoint.safetensors").unlink(missing_ok=True)
    if not refused(code, "\n".join(line for line in err.splitlines() if line.startswith("error")) + "\n" if code else ""):
        assert (tmp_path / "w.safetensors").is_file()


@drawn(40)
@given(
    offset=st.floats(0.0, 1.0),
    how=st.sampled_from(["cut", "flip header", "card"]),
    card=st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["network", "width", "run", "calibration"]), inner, max_size=4)
        ),
        max_leaves=6,
    ),
)
def test_damaged_weights_are_refused(tmp_path, offset, how, card):
    from safetensors.torch import save_file

    file = tmp_path / f"w{np.random.default_rng().integers(2**60)}.safetensors"
    if how == "card":
        import torch

        save_file({"x": torch.zeros(3)}, file, metadata={"card": json.dumps(card)})
    else:
        held = DEFAULT_WEIGHTS.read_bytes()
        at = int(offset * (len(held) - 1)) if how == "cut" else int(offset * 2000)
        file.write_bytes(held[:at] if how == "cut" else held[:at] + bytes([held[at] ^ 0x81]) + held[at + 1 :])
    try:
        network, _ = load_network(file)
    except InputError as error:
        assert is_one_line(error)  # noqa: PT017 - not every example is refused
    else:
        assert sum(parameter.numel() for parameter in network.parameters()) > 7e6
    finally:
        file.unlink()
