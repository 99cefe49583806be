"""Addition of many frames by several threads and by a Dask cluster, and continuation from saved sums."""

import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from correlograph.errors import InputError
from correlograph.files import captured_frames as capture_module
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import read_capture
from correlograph.files.corrections import Corrections
from invert.measure.estimate import estimate_from_frames
from invert.request import Request
from radiometry.autocorrelation import patch_grid
from radiometry.estimation import parallel_frames
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator, estimate_autocorrelation
from radiometry.estimation.parallel_frames import PART_FRAMES, add_frames
from radiometry.estimation.saved_sums import SavedSums

SHAPE, PATCH = (300, 421), 129


def _frames(count: int, seed: int = 3) -> list[np.ndarray]:
    """Return frames of a static, asymmetric pattern that moves after the tenth frame, with grains, shot noise and hot pixels."""
    rng = np.random.default_rng(seed)
    pattern = rng.gamma(4.0, 0.25, SHAPE)
    frames = []
    for number in range(count):
        field = np.fft.rfft2(rng.standard_normal(SHAPE))
        rows, columns = np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])[None]
        grains = np.fft.irfft2(field * np.exp(-200.0 * (rows**2 + 2.0 * columns**2)), SHAPE)
        light = (grains / grains.std()) ** 2 * np.roll(pattern, (3, -2) if number > 10 else (0, 0), (0, 1))
        frame = rng.poisson(20.0 * light).astype(np.float32)
        frame[number, 7] = 4000.0
        frames.append(frame)
    return frames


def _sums(frames: list[np.ndarray], saved: SavedSums | None = None, threads: int = 2) -> AutocorrelationEstimator:
    estimator = AutocorrelationEstimator(patch_grid(SHAPE, PATCH))
    add_frames(estimator, frames, saved=saved, threads=threads)
    return estimator


def test_sums_do_not_depend_on_the_number_of_threads() -> None:
    frames = _frames(3 * PART_FRAMES + 3)
    alone, four = _sums(frames, threads=1), _sums(frames, threads=4)
    np.testing.assert_array_equal(alone.estimate(), four.estimate())
    assert alone.background == four.background
    assert alone.background.hot_pixels == len(frames)
    assert alone.background.shift_pixels == pytest.approx((3.0, -2.0), abs=0.2)


def test_parts_give_the_estimate_of_frames_one_by_one() -> None:
    frames = _frames(2 * PART_FRAMES + 5)
    expected, dof = estimate_autocorrelation(frames, patch_grid(SHAPE, PATCH))
    found = _sums(frames)
    np.testing.assert_allclose(found.estimate(), expected, atol=1e-6 * expected.max())
    assert found.dof == dof


@pytest.mark.parametrize("first", [2 * PART_FRAMES, 2 * PART_FRAMES + 3])
def test_a_growing_capture_continues_from_its_sums(tmp_path: Path, first: int, monkeypatch: pytest.MonkeyPatch) -> None:
    frames, file = _frames(4 * PART_FRAMES), tmp_path / "sums.npz"
    _sums(frames[:first], SavedSums(file))
    added: list[int] = []
    add = AutocorrelationEstimator.sums_of
    monkeypatch.setattr(
        AutocorrelationEstimator, "sums_of", lambda self, frame, number: added.append(number) or add(self, frame, number)
    )
    continued = _sums(frames, SavedSums(file))
    assert set(added) == {*range(PART_FRAMES), *range(first, len(frames))}  # the others are read for their digests only
    monkeypatch.undo()
    expected = _sums(frames)
    np.testing.assert_allclose(continued.estimate(), expected.estimate(), atol=1e-6 * expected.estimate().max())
    assert continued.background.hot_pixels == expected.background.hot_pixels
    assert continued.background.shift_pixels == expected.background.shift_pixels
    assert continued.sums.levels == expected.sums.levels
    for one, other in zip(continued.filtered_frames().spectra, expected.filtered_frames().spectra, strict=True):
        np.testing.assert_array_equal(one.numpy(), other.numpy())


def test_sums_of_other_frames_patches_or_damaged_ones_are_ignored(tmp_path: Path) -> None:
    frames, file = _frames(2 * PART_FRAMES), tmp_path / "sums.npz"
    _sums(frames, SavedSums(file))
    intact = file.read_bytes()
    others = _frames(2 * PART_FRAMES, seed=4)
    changed_last = [*frames[:-1], others[-1]]
    changed_middle = [*frames[:PART_FRAMES], others[0], *frames[PART_FRAMES + 1 :]]
    for given in (others, changed_last, changed_middle, frames[:-1], frames[1:]):
        file.write_bytes(intact)
        np.testing.assert_array_equal(_sums(given, SavedSums(tmp_path / "copy.npz")).estimate(), _sums(given).estimate())
        estimator = AutocorrelationEstimator(patch_grid(SHAPE, PATCH))
        for number in range(PART_FRAMES):
            estimator.add(given[number])
        SavedSums(file).continue_with(estimator, given)
        assert estimator.frames == PART_FRAMES
    estimator = AutocorrelationEstimator(patch_grid(SHAPE, 151))
    for number in range(PART_FRAMES):
        estimator.add(frames[number])
    with np.load(file) as archive:
        content = dict(archive)
    for name, change in (("power", 2.0), ("power", np.nan), ("levels", 1.5), ("spectrum", np.nan)):
        np.savez(file, **{**content, name: content[name] * change})
        whole = AutocorrelationEstimator(patch_grid(SHAPE, PATCH))
        for number in range(PART_FRAMES):
            whole.add(frames[number])
        SavedSums(file).continue_with(whole, frames)
        assert whole.frames == PART_FRAMES, (name, change)
    for content in (intact, intact[: len(intact) // 2], b""):
        file.write_bytes(content)
        SavedSums(file).continue_with(estimator, frames)
        assert estimator.frames == PART_FRAMES


def test_a_stack_that_grows_gives_the_estimate_of_its_frames_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames, stack, sums = np.stack(_frames(PART_FRAMES * 2 + 4)), tmp_path / "run.npy", tmp_path / "out" / "frame_sums.npz"
    sums.parent.mkdir()
    monkeypatch.setattr(capture_module, "MAX_KEPT_BYTES", 0)
    for count in (PART_FRAMES + 5, len(frames)):
        np.save(stack, frames[:count].astype(np.uint16))
        found = estimate_from_frames(read_capture([stack], CameraMetadata()), Request(patch=PATCH, lags=63, sums_file=sums))
        assert sums.is_file()
        expected = estimate_from_frames(Capture(list(frames[:count])), Request(patch=PATCH, lags=63))
        np.testing.assert_allclose(found.values, expected.values, atol=1e-6 * expected.values.max())


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Yield the address of a Dask cluster of two processes on this machine."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def _capture_in_files(folder: Path, frames: list[np.ndarray]) -> Capture:
    """Return a capture of a stack, of single files and of a dark frame, none of which is kept in memory."""
    half = len(frames) // 2
    np.save(folder / "a.npy", np.stack(frames[:half]).astype(np.uint16))
    for number, frame in enumerate(frames[half:]):
        np.save(folder / f"b{number:03}.npy", frame)
    dark = np.full(SHAPE, 2.0, np.float32)
    np.save(folder.parent / "dark.npy", dark)
    return Corrections(dark=folder.parent / "dark.npy").apply(read_capture([folder], CameraMetadata()))


@pytest.mark.slow
def test_a_cluster_gives_the_sums_of_this_machine(tmp_path: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "MAX_KEPT_BYTES", 0)
    monkeypatch.setattr(parallel_frames, "BLOCK_FRAMES", PART_FRAMES + 3)
    (tmp_path / "capture").mkdir()
    capture = _capture_in_files(tmp_path / "capture", _frames(4 * PART_FRAMES + 1))
    here = estimate_from_frames(capture, Request(patch=PATCH, lags=63))
    there = estimate_from_frames(capture, Request(patch=PATCH, lags=63, scheduler=scheduler))
    np.testing.assert_array_equal(there.values, here.values)
    assert there.record == here.record


def test_a_cluster_finds_a_copy_of_a_frame(tmp_path: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "MAX_KEPT_BYTES", 0)
    monkeypatch.setattr(parallel_frames, "BLOCK_FRAMES", PART_FRAMES)
    frames = _frames(4 * PART_FRAMES)
    frames[3 * PART_FRAMES + 2] = frames[PART_FRAMES + 5]  # in another block
    (tmp_path / "capture").mkdir()
    capture = _capture_in_files(tmp_path / "capture", frames)
    with pytest.raises(InputError, match="repeats an earlier frame"):
        estimate_from_frames(capture, Request(patch=PATCH, lags=63, scheduler=scheduler))


def test_frames_in_files_can_be_pickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "MAX_KEPT_BYTES", 0)
    (tmp_path / "capture").mkdir()
    monkeypatch.chdir(tmp_path)
    frames = _capture_in_files(Path("capture"), _frames(6)).frames
    sent = pickle.dumps(frames)
    monkeypatch.chdir("/")  # a worker may run in another folder
    for one, other in zip(pickle.loads(sent), frames, strict=True):
        np.testing.assert_array_equal(one, other)
