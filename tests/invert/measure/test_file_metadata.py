"""Exposure, pixel pitch, gain, bits and time from files, and what becomes of them."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from PIL import Image

import correlograph as cg
from correlograph.errors import InputError
from correlograph.files.captured_frames import describe_files, read_capture
from correlograph.files.file_metadata import FileMetadata, read_metadata

SHAPE = (160, 210)


@pytest.fixture
def frames(rng) -> np.ndarray:
    return rng.poisson(5.0, (2, *SHAPE)).astype(np.uint16)


def _write_ome(file, frames, **changed) -> None:
    plane = {"ExposureTime": [125.0, 125.0], "ExposureTimeUnit": ["ms", "ms"]}
    metadata = {"axes": "TYX", "PhysicalSizeX": 6.9, "PhysicalSizeXUnit": "µm", "SignificantBits": 12, "Plane": plane}
    tifffile.imwrite(file, frames, ome=True, metadata=metadata | changed)


def test_ome_metadata(tmp_path, frames):
    _write_ome(tmp_path / "a.ome.tif", frames)
    found = read_metadata(tmp_path / "a.ome.tif")
    assert found == FileMetadata(exposure_s=0.125, pixel_pitch_m=pytest.approx(6.9e-6), bits=12)


def test_pixels_that_are_not_square(tmp_path, frames):
    """Twice as high as wide, in another unit; pitches that are given stand for both."""
    _write_ome(tmp_path / "a.ome.tif", frames, PhysicalSizeY=13800.0, PhysicalSizeYUnit="nm")
    known = cg.CameraMetadata(wavelength_m=532e-9, distance_m=1.0)
    capture = read_capture([tmp_path / "a.ome.tif"], known)
    assert capture.camera.lag_geometry[2] == pytest.approx((13.8e-6, 6.9e-6))
    assert "6.9 um (rows: 13.8 um)" in describe_files(capture)[0]
    given = read_capture([tmp_path / "a.ome.tif"], replace(known, pixel_pitch_m=5e-6))
    assert given.camera.lag_geometry[2] == pytest.approx((5e-6, 5e-6))


def test_micro_manager_tags(tmp_path, frames):
    tag = json.dumps({"Exposure-ms": 8.0, "PixelSizeUm": 3.45, "BitDepth": 16, "ReceivedTime": "2026-11-23 10:00:00"})
    extra = [(51123, "s", 0, tag, True)]
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack", metadata=None, extratags=extra)
    found = read_metadata(tmp_path / "a.tif")
    expected = FileMetadata(0.008, pytest.approx(3.45e-6), None, 16, "2026-11-23 10:00:00")
    assert found == expected


def test_fits_header(tmp_path, frames):
    fits = pytest.importorskip("astropy.io.fits")
    header = fits.Header({"EXPTIME": 0.5, "EGAIN": 0.37, "DATE-OBS": "2026-11-23T10:00:00"})
    fits.writeto(tmp_path / "a.fits", frames.astype(np.int16), header)
    assert read_metadata(tmp_path / "a.fits") == FileMetadata(0.5, None, 0.37, None, "2026-11-23T10:00:00")


@pytest.mark.filterwarnings("ignore")
def test_a_bad_card_and_a_camera_in_the_first_header_of_a_fits_file(tmp_path, frames):
    fits = pytest.importorskip("astropy.io.fits")
    first = fits.PrimaryHDU()
    first.header["EXPTIME"] = 0.25
    first.header.append(fits.Card.fromstring("FOO     = 1.0.0"))
    fits.HDUList([first, fits.ImageHDU(frames[0].astype(np.int16))]).writeto(tmp_path / "a.fits", output_verify="warn")
    assert read_metadata(tmp_path / "a.fits").exposure_s == 0.25


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"EXPTIME": 0.505, "EGAIN": 0.37}, None),  # as measured by the camera
        ({"EXPTIME": 0.25, "EGAIN": 0.37}, "exposure_s 0.5, as a.fits.*0.25 in b.fits"),
        ({"EXPTIME": 0.5, "EGAIN": 0.74}, "gain_e 0.37, as a.fits.*0.74 in b.fits"),
        ({}, None),
    ],
)
def test_files_of_two_camera_settings_are_refused(tmp_path, frames, second, message):
    fits = pytest.importorskip("astropy.io.fits")
    for name, values, frame in zip("ab", ({"EXPTIME": 0.5, "EGAIN": 0.37}, second), frames.astype(np.int16), strict=True):
        fits.writeto(tmp_path / f"{name}.fits", frame, fits.Header(values))
    with nullcontext() if message is None else pytest.raises(InputError, match=message):
        read_capture([tmp_path], cg.CameraMetadata())


@pytest.mark.parametrize(("unit", "exposure_s"), [("ms", 0.02), ("s", 20.0), ("furlong", None)])
def test_nexus_datasets(tmp_path, frames, unit, exposure_s):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.nxs", "w") as file:
        file["entry/detector/data"] = frames
        file["entry/detector/count_time"] = 20.0
        file["entry/detector/count_time"].attrs["units"] = unit
        file["entry/start_time"] = "2026-11-23T10:00:00"
    assert read_metadata(tmp_path / "a.nxs::/entry/detector/data") == FileMetadata(exposure_s, time="2026-11-23T10:00:00")


def test_description_of_raw_frames(tmp_path, frames):
    frames.astype("<u2").tofile(tmp_path / "a.raw")
    description = {"width": SHAPE[1], "height": SHAPE[0], "pixel_format": "Mono16", "exposure_s": 0.01, "gain_e": 0.4}
    (tmp_path / "a.raw.json").write_text(json.dumps(description))
    assert read_metadata(tmp_path / "a.raw") == FileMetadata(0.01, gain_e=0.4)


@pytest.mark.parametrize("changed", [{"PhysicalSizeX": -1.0}, {"PhysicalSizeXUnit": "pixel"}, {"PhysicalSizeX": "nan"}])
def test_impossible_values_count_as_missing(tmp_path, frames, changed):
    _write_ome(tmp_path / "a.ome.tif", frames, **changed)
    assert read_metadata(tmp_path / "a.ome.tif").pixel_pitch_m is None


def test_files_without_metadata_and_damaged_ones(tmp_path, frames):
    np.save(tmp_path / "a.npy", frames)
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack", metadata=None)
    (tmp_path / "b.tif").write_bytes(b"II*\0")
    for name in ("a.npy", "a.tif", "b.tif"):
        assert read_metadata(tmp_path / name) == FileMetadata()


def test_the_pitch_of_a_file_sets_the_scale_where_no_option_does(tmp_path, frames):
    _write_ome(tmp_path / "a.ome.tif", frames)
    camera = {"wavelength_m": 532e-9, "distance_m": 0.3}
    settings = {"patch": 150, "method": "classical", "quality": "fast"}
    found = cg.reconstruct(tmp_path / "a.ome.tif", camera=cg.CameraMetadata(**camera), **settings)
    assert found.estimate.pitches_m == pytest.approx((532e-9 * 0.3 / (150 * 6.9e-6),) * 2)
    assert any("6.9 um comes from the metadata of a.ome.tif" in note for note in found.notes)
    assert found.save(tmp_path / "out")["file_metadata"]["exposure_s"] == 0.125
    own = cg.CameraMetadata(**camera, pixel_pitch_m=5e-6)
    given = cg.reconstruct(tmp_path / "a.ome.tif", camera=own, **settings)
    assert given.estimate.pitches_m == pytest.approx((532e-9 * 0.3 / (150 * 5e-6),) * 2)
    assert not any("metadata" in note for note in given.notes)
    assert cg.reconstruct(tmp_path / "a.ome.tif", **settings).estimate.pitches_m is None
    np.save(tmp_path / "a.npy", frames)
    with pytest.raises(InputError, match="pixel_pitch_m"):
        cg.reconstruct(tmp_path / "a.npy", camera=cg.CameraMetadata(**camera), **settings)


@pytest.mark.parametrize("bad", [7, [1], {"a": 1}, True, None, "x" * 1000, 1e999])
@pytest.mark.parametrize("name", ["exposure_s", "gain_e", "bits", "time"])
def test_one_bad_value_of_a_raw_description_leaves_the_others(tmp_path, rng, name, bad):
    rng.integers(0, 4096, SHAPE).astype("<u2").tofile(tmp_path / "a.raw")
    good = {"exposure_s": 0.1, "pixel_pitch_m": 6.9e-6, "gain_e": 0.5, "bits": 12, "time": "noon"}
    size = {"width": SHAPE[1], "height": SHAPE[0], "pixel_format": "Mono12"}
    (tmp_path / "a.raw.json").write_text(json.dumps(size | good | {name: bad}))
    found = read_metadata(tmp_path / "a.raw").as_dict()
    assert {key: value for key, value in found.items() if key != name} == {k: v for k, v in good.items() if k != name}


@pytest.mark.parametrize(("name", "channels"), [("a.png", 3), ("a.png", 4), ("a.tif", 3), ("a.jpg", 3), ("a.jpeg", 1)])
def test_pictures_with_equal_channels_are_read_with_a_note(tmp_path, rng, name, channels):
    grey = rng.poisson(60.0, (300, 420)).clip(0, 255).astype(np.uint8)
    picture = np.dstack([grey] * min(channels, 3) + [np.full_like(grey, 255)] * (channels == 4)).squeeze()
    if name.endswith("tif"):
        tifffile.imwrite(tmp_path / name, picture, photometric="rgb")
    else:
        Image.fromarray(picture).save(tmp_path / name, **({"quality": 100, "subsampling": 0} if "jp" in name else {}))
    capture = read_capture([tmp_path / name], cg.CameraMetadata())
    assert np.abs(capture.frames[0] - grey).max() <= (4 if "jp" in name else 0)
    notes = " ".join(describe_files(capture))
    assert (f"the {channels} channels of {name} are equal" in notes) == (channels > 1)
    assert ("JPEG" in notes) == ("jp" in name)


def test_coloured_pictures_and_damaged_jpeg_files_are_refused(tmp_path, rng):
    coloured = rng.integers(0, 255, (300, 420, 3)).astype(np.uint8)
    for name in ("a.png", "a.jpg", "a.tif"):
        Image.fromarray(coloured).save(tmp_path / name)
        with pytest.raises(InputError, match="monochrome"):
            read_capture([tmp_path / name], cg.CameraMetadata())
    content = (tmp_path / "a.jpg").read_bytes()
    for damaged in (content[: len(content) // 2], b"", b"GIF89a" + content[6:]):
        (tmp_path / "b.jpg").write_bytes(damaged)
        with pytest.raises(InputError, match=r"b\.jpg"):
            read_capture([tmp_path / "b.jpg"], cg.CameraMetadata())


def test_jpeg_previews_beside_frames_are_skipped(tmp_path, rng, capsys):
    for number in range(2):
        tifffile.imwrite(tmp_path / f"{number}.tif", rng.poisson(60.0, (300, 420)).astype(np.uint16))
        Image.fromarray(rng.poisson(60.0, (60, 84)).astype(np.uint8)).save(tmp_path / f"{number}.jpg")
    assert len(read_capture([tmp_path], cg.CameraMetadata()).frames) == 2
    assert capsys.readouterr().err.startswith("skipped 0.jpg and 1 more in ")
