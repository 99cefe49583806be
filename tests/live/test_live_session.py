"""Live view without a browser: growing sources, running estimate, saved frames, dropped frames."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

import correlograph as cg
from correlograph.errors import InputError
from correlograph.lags import lag_grid
from correlograph.live.frame_report import covariance_line, grain_width
from correlograph.live.page import PICTURES, _result_rows, pictures, table
from correlograph.live.session import LiveSession
from correlograph.live.sources import GrowingFiles
from correlograph.live.threads import WAITING, Acquisition
from invert.assess.speckle_test import SpeckleTest
from invert.measure.estimate import estimate_from_frames
from invert.request import Request
from tests.light import speckle

CAMERA = cg.CameraMetadata(532e-9, 7e-6, 1.0)
RING = lag_grid(63).ring


def letter_frames(count: int, seed: int = 0) -> list[np.ndarray]:
    albedo = np.zeros((64, 64), np.float32)
    albedo[20:42, 24:28] = albedo[38:42, 24:38] = 1.0
    rng = np.random.default_rng(seed)
    return [np.asarray(speckle(albedo, (560, 700), rng), np.float32) for _ in range(count)]


class Camera:
    """Frames of a list, at an interval."""

    def __init__(self, frames, interval_s=0.0):
        self.camera, self._frames, self._interval_s = CAMERA, frames, interval_s

    def __iter__(self):
        for frame in self._frames:
            time.sleep(self._interval_s)
            yield frame


def test_the_estimate_is_that_of_the_same_frames_in_a_capture():
    frames = letter_frames(3)
    session = LiveSession(CAMERA)
    for frame in frames:
        session.add(frame)
    live = session.estimate()
    capture = cg.Capture(frames, CAMERA, ("a", "b", "c"))
    size = live.record.grid.size
    np.testing.assert_array_equal(live.values, estimate_from_frames(capture, Request(patch=size, lags=63)).values)
    report = session.report(live)
    assert report.frames == 3
    assert report.detection > 6.0
    assert report.detected_in_frames == 0


def test_forgotten_frames_leave_no_trace():
    """The first frames hold no object; after `forget` further ones, the estimate is that of the latter alone."""
    rng = np.random.default_rng(1)
    session = LiveSession(CAMERA, forget=4)
    for _ in range(3):
        session.add(rng.exponential(1.0, (560, 700)).astype(np.float32))
    frames = letter_frames(8)
    for number, frame in enumerate(frames):
        session.add(frame)
        assert number < 4 or 2 <= session.frames <= 4
    kept = session.frames
    only = LiveSession(CAMERA)
    for frame in frames[-kept:]:
        only.add(frame)
    np.testing.assert_array_equal(session.estimate().values, only.estimate().values)


@pytest.mark.parametrize(("camera", "exposure_s"), [(CAMERA, 0.1), (cg.CameraMetadata(), None)])
def test_saved_frames_are_a_capture_for_invert(tmp_path, camera, exposure_s):
    session = LiveSession(camera, exposure_s)
    for frame in letter_frames(3):
        session.add(frame)
    first, second = session.save(tmp_path / "live"), session.save(tmp_path / "live")
    assert (first.name, second.name) == ("capture_001", "capture_002")
    files = [path for path in first.iterdir() if not path.name.startswith(".")]
    result = cg.reconstruct(files[0] if camera is not CAMERA else first, quality="fast")
    assert result.estimate.record.frames == 3
    assert result.object_found
    live = session.estimate()
    if result.estimate.record.grid == live.record.grid:
        np.testing.assert_array_equal(result.estimate.values, live.values)
    assert not [path for path in (tmp_path / "live").iterdir() if "partial" in path.name]


def test_frames_of_another_size_are_refused():
    session = LiveSession(CAMERA)
    session.add(np.ones((300, 200), np.float32) * np.random.default_rng(0).random((300, 200)))
    with pytest.raises(InputError, match="300 x 200"):
        session.add(np.ones((200, 300), np.float32))
    frame = np.random.default_rng(0).random((300, 200))
    frame[3, 4] = np.nan
    with pytest.raises(InputError, match="NaN"):
        session.add(frame)
    assert session.frames == 1
    session.restart()
    session.add(np.random.default_rng(0).random((200, 300)))
    with pytest.raises(InputError, match="frames to save"):
        LiveSession(CAMERA).save("/nonexistent")


def test_a_growing_stack_and_folder_yield_each_frame_once(tmp_path):
    pages = np.random.default_rng(2).integers(0, 999, (5, 64, 80)).astype(np.uint16)
    stack = tmp_path / "run.tif"
    tifffile.imwrite(stack, pages[:2])
    frames = iter(GrowingFiles(stack, CAMERA))
    seen = [next(frames) for _ in range(2)]
    tifffile.imwrite(stack, pages)
    seen += [next(frames) for _ in range(3)]
    np.testing.assert_array_equal(np.stack(seen), pages)

    folder = tmp_path / "frames"
    folder.mkdir()
    source = GrowingFiles(folder, CAMERA)
    frames = iter(source)
    (folder / "0.tif").write_bytes(b"II*\0half")  # a file that is still being written

    def complete() -> None:
        time.sleep(1.0)
        tifffile.imwrite(folder / "0.tif", pages[3])
        tifffile.imwrite(folder / "1.tif", pages[4])

    threading.Thread(target=complete).start()
    np.testing.assert_array_equal(next(frames), pages[3])
    np.testing.assert_array_equal(next(frames), pages[4])
    assert source.skipped == []


def test_a_dark_frame_corrects_the_estimate_and_not_the_saved_frames(tmp_path):
    frames = letter_frames(2)
    rng = np.random.default_rng(3)
    dark = (100.0 + 0.2 * frames[0].mean() * rng.standard_normal(frames[0].shape)).astype(np.float32)
    np.save(tmp_path / "dark.npy", dark)
    session, clean = LiveSession(CAMERA, corrections=cg.Corrections(tmp_path / "dark.npy")), LiveSession(CAMERA)
    for frame in frames:
        session.add(frame + dark)
        clean.add(frame)
    corrected, known = session.estimate().values, clean.estimate().values
    signal = known - np.median(known)
    assert np.abs(corrected - known)[RING > 1].max() < 0.05 * signal[RING > 1].max()
    assert len(session.contrasts) == 2
    assert session.contrasts[-1] == pytest.approx(clean.contrasts[-1], rel=0.05)
    np.testing.assert_allclose(np.load(session.save(tmp_path / "saved") / "frames.npy"), np.stack(frames) + dark, rtol=1e-6)
    session.restart()
    assert not session.contrasts


def test_pictures_and_skipped_files_of_the_page():
    acquisition = Acquisition(Camera(letter_frames(2)), LiveSession(CAMERA))
    assert pictures(acquisition) == {}
    acquisition.source.skipped = ["a.tif: no | picture"]
    acquisition.start()
    acquisition.finished.wait(60.0)
    acquisition.join()
    shown = pictures(acquisition)
    assert set(shown) == {*PICTURES} - {"path"}  # nothing moves
    assert all(one.startswith(b"\x89PNG") for one in shown.values())
    assert "| **files skipped** | 1, the latest a.tif: no / picture |" in table(acquisition)


def test_an_unreadable_file_is_skipped_and_named(tmp_path, monkeypatch):
    monkeypatch.setattr("correlograph.live.sources.PATIENCE_S", 0.3)
    (tmp_path / "a.tif").write_bytes(b"no image")
    page = np.arange(64 * 80, dtype=np.uint16).reshape(64, 80)
    tifffile.imwrite(tmp_path / "b.tif", page)
    source = GrowingFiles(tmp_path, CAMERA)
    frames = iter(source)
    np.testing.assert_array_equal(next(frames), page)
    threading.Thread(target=lambda: (time.sleep(1.5), tifffile.imwrite(tmp_path / "c.tif", page + 1)), daemon=True).start()
    np.testing.assert_array_equal(next(frames), page + 1)
    assert len(source.skipped) == 1
    assert source.skipped[0].startswith("a.tif: ")


def test_frames_that_arrive_too_fast_are_dropped_and_counted():
    class SlowSession(LiveSession):
        def add(self, frame, number=None):
            time.sleep(0.2)
            super().add(frame, number)

    acquisition = Acquisition(Camera(letter_frames(2) * 10, 0.01), SlowSession(CAMERA))
    acquisition.start()
    acquisition.finished.wait(20.0)
    deadline = time.monotonic() + 20.0
    while acquisition.session.frames + acquisition.dropped < 20 and time.monotonic() < deadline:
        time.sleep(0.05)
    acquisition.join()
    assert acquisition.received == 20
    assert acquisition.dropped > WAITING
    assert acquisition.session.frames + acquisition.dropped == 20


def test_bad_frames_are_named_and_a_failing_source_says_why():
    class Failing(Camera):
        def __iter__(self):
            yield from super().__iter__()
            raise RuntimeError("the cable is loose")

    frames = letter_frames(3)
    frames[1] = frames[1][:-8]
    acquisition = Acquisition(Failing(frames), LiveSession(CAMERA))
    acquisition.start()
    acquisition.finished.wait(60.0)
    acquisition.join()
    assert acquisition.session.frames == 2
    shown = table(acquisition)
    assert "| **frames skipped** | 1, the latest frame: expected" in shown
    assert "| **stopped** | RuntimeError: the cable is loose |" in shown


def test_requests_and_restarts_need_no_further_frame():
    class Pausing(Camera):
        def __iter__(self):
            yield from super().__iter__()
            time.sleep(120.0)

    def wait_until(condition) -> None:
        deadline = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.05)

    acquisition = Acquisition(Pausing(letter_frames(2)), LiveSession(CAMERA))
    acquisition.start()
    wait_until(lambda: acquisition.result is not None)
    before = acquisition.result
    acquisition.request("fast")
    wait_until(lambda: acquisition.result is not before)
    assert not acquisition.pending_quality
    acquisition.request("balanced")
    assert "a reconstruction with quality balanced" in table(acquisition)
    time.sleep(2.0)
    begin = time.monotonic()
    acquisition.abandon()
    acquisition.join()
    assert time.monotonic() - begin < 10.0
    acquisition.restart()
    assert pictures(acquisition).keys() == {"frame", "histogram and contrast"}


def test_the_page_says_for_how_long_no_frame_has_arrived(monkeypatch):
    acquisition = Acquisition(Camera(letter_frames(2)), LiveSession(CAMERA))
    assert "waiting for the first" in table(acquisition)
    acquisition.start()
    acquisition.finished.wait(60.0)
    acquisition.join()
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 40.0)
    assert "| **frames received** | 2; the latest 4" in table(acquisition)


def test_it_stops_when_a_reconstruction_is_sure_enough():
    rng = np.random.default_rng(7)  # with shot noise, no number of frames raises a doubt
    frames = [rng.poisson(5.0 * frame).astype(np.float32) for frame in letter_frames(40)]
    acquisition = Acquisition(Camera(frames, 1.0), LiveSession(CAMERA), until=0.6)
    acquisition.start()
    assert acquisition.finished.wait(120.0)
    acquisition.join()
    assert acquisition.result.confidence >= 0.6
    assert acquisition.received < 40
    assert acquisition.problem == ""


def test_the_grain_width_is_that_of_a_filtered_field():
    """A field with a Gaussian spectrum of width s has the intensity covariance exp(-(x / c)^2) with c = 1 / (sqrt(2) pi s)."""
    rng = np.random.default_rng(3)
    width = 0.04
    frequency = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.fftfreq(512)[None])
    noise = rng.standard_normal((512, 512)) + 1j * rng.standard_normal((512, 512))
    field = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((frequency / width) ** 2) / 2.0))
    # |<E E*>|^2 = exp(-2 (pi width x)^2): half at x = sqrt(ln 2 / 2) / (pi width)
    expected = 2.0 * np.sqrt(np.log(2.0) / 2.0) / (np.pi * width)
    light = np.abs(field) ** 2
    line = covariance_line(rng.poisson(2.0 * light / light.mean()))
    assert grain_width(line) == pytest.approx(expected, abs=2.5)
    # The covariance one pixel apart falls short of the variance by the fraction 1 - exp(-2 (pi width)^2).
    assert line[1] / 2.0**2 == pytest.approx(np.exp(-2.0 * (np.pi * width) ** 2), rel=0.1)


def test_the_documented_camera_runs(tmp_path, monkeypatch):
    """The block of docs/live.md with a camera that delivers two frames, without waiting for the user."""
    pytest.importorskip("panel")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[2] / "docs" / "live.md"
    block = page.read_text().split("```py\n")[1].split("```")[0].replace("page.wait()", "")
    frames = iter(letter_frames(2))

    def read_one_frame() -> np.ndarray:
        time.sleep(0.1)
        return next(frames, None) if values["acquisition"].received < 2 else values["acquisition"].finished.wait()

    values = {"read_one_frame": read_one_frame}
    exec(compile(block, "docs/live.md", "exec"), values)
    acquisition = values["acquisition"]
    deadline = time.monotonic() + 30.0
    while acquisition.result is None and time.monotonic() < deadline:
        time.sleep(0.1)
    acquisition.stop()
    acquisition.join()
    values["page"].server.stop()
    assert acquisition.problem == ""
    assert acquisition.result.estimate.record.frames <= 2
    assert values["page"].address.startswith("http://127.0.0.1:")


def test_the_page_reports_a_result_whose_third_moment_is_unknown():
    """No lag of faint frames holds enough signal for the third moment."""
    lags = np.random.default_rng(1).gamma(300.0, 1.0 / 300.0, (127, 127))
    result = cg.reconstruct((lags + lags[::-1, ::-1]).astype(np.float32), quality="fast", autocorrelation=True)
    rows = dict(_result_rows(replace(result, speckle_test=SpeckleTest(None, None, 0.1))))
    assert "object" in rows
    assert not any("third moment" in name for name in rows)
