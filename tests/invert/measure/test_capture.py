"""Frames from files of several kinds, and refusals of what cannot be speckle."""

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
from PIL import Image
from skimage import io

import invert
from benchmarks.nuisances import speckle
from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import find_frames, read_capture
from correlograph.files.corrections import Corrections
from correlograph.files.exr_frames import FrameHeader, write_frame
from correlograph.files.images import read_autocorrelation, read_image
from invert.sources import read_source

UNKNOWN = CameraMetadata()


def header(**changes) -> FrameHeader:
    return FrameHeader(
        **{
            **dict(
                wavelength_m=532e-9,
                pixel_pitch_m=6.9e-6,
                distance_m=1.0,
                exposure_s=1.0,
                seed=0,
                frame=0,
                scene_sha256="",
                version="0",
            ),
            **changes,
        }
    )


def test_frames_are_in_the_order_of_their_numbers(tmp_path, rng):
    """Cameras that do not pad numbers with zeros write shot_10 after shot_9."""
    for number in (*range(1, 13), 100):
        np.save(tmp_path / f"run2_shot_{number}.npy", rng.random((130, 140)).astype(np.float32) + number)
    capture = read_capture([tmp_path], CameraMetadata())
    assert [int(frame.mean()) for frame in capture.frames] == [*range(1, 13), 100]


@pytest.mark.parametrize("kind", ["npy", "png", "tif", "exr"])
def test_kinds_of_files(tmp_path, rng, kind):
    frames = [rng.integers(0, 60000, (130, 140)).astype(np.uint16) for _ in range(2)]
    for number, frame in enumerate(frames):
        path = tmp_path / f"{number}.{kind}"
        if kind == "npy":
            np.save(path, frame)
        elif kind == "exr":
            write_frame(path, frame, header(frame=number))
        else:
            Image.fromarray(frame).save(path)
    (tmp_path / "notes.txt").write_text("not a frame")
    capture = read_capture([tmp_path], UNKNOWN)
    assert all(np.array_equal(a, b) for a, b in zip(capture.frames, frames, strict=True))
    assert (capture.camera.lag_geometry is not None) == (kind == "exr")


def test_options_win_over_headers_and_dark_frames_are_subtracted(tmp_path, rng):
    frame = rng.random((130, 130)).astype(np.float32)
    write_frame(tmp_path / "a.exr", frame, header())
    np.save(tmp_path / "dark.npy", np.full((130, 130), 0.25))
    capture = read_capture([tmp_path / "a.exr"], CameraMetadata(distance_m=2.5))
    capture = Corrections(tmp_path / "dark.npy").apply(capture)
    wavelength_m, distance_m, pitches_m = capture.camera.lag_geometry
    assert (wavelength_m, distance_m, *pitches_m) == pytest.approx((532e-9, 2.5, 6.9e-6, 6.9e-6))
    np.testing.assert_allclose(capture.frames[0], frame - 0.25, atol=1e-6)


def test_flat_field_and_mask(tmp_path, rng):
    """(frame - dark) / (flat - dark), brightness kept; what is masked is the mean of the rest."""
    light, sensitivity = rng.random((130, 140)), rng.uniform(0.5, 1.5, (130, 140))
    mask = rng.random((130, 140)) < 0.9
    for name, array in {
        "a": 3.0 * light * sensitivity + 2.0,
        "dark": np.full((130, 140), 2.0),
        "flat": 5.0 * sensitivity + 2.0,
        "mask": mask.astype(float),
    }.items():
        np.save(tmp_path / f"{name}.npy", array)
    corrections = Corrections(tmp_path / "dark.npy", tmp_path / "flat.npy", tmp_path / "mask.npy")
    found = corrections.apply(read_capture([tmp_path / "a.npy"], UNKNOWN)).frames[0]
    expected = 3.0 * light * sensitivity.mean()
    np.testing.assert_allclose(found[mask], expected[mask], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found[~mask], expected[mask].mean(), rtol=1e-5)
    assert Corrections().apply(read_capture([tmp_path / "a.npy"], UNKNOWN)).frames[0].max() > 5.0


@pytest.mark.parametrize(
    ("kept", "dof_share"),
    [("left half", 0.5), ("blocks", 0.75), ("every other pixel of a colour camera", 1.0), ("random half", 1.0)],
)
def test_speckle_behind_a_mask_is_judged_as_speckle(rng, kept, dof_share):
    """Sharp frames, part of them masked: contrast 1, third moment of speckle, no doubt, and the degrees of freedom that are left: all
    of them behind a fine mask, which hides parts of each grain."""
    albedo = np.zeros((64, 64))
    albedo[16:48, 20:26] = albedo[16:21, 20:44] = albedo[30:35, 20:38] = 1.0
    frames = np.stack([rng.poisson(5.0 * speckle(albedo, rng, shape=(800, 900))) for _ in range(3)]).astype(np.float32)
    mask = np.ones((800, 900))
    if kept == "left half":
        mask[:, 450:] = 0.0
    elif kept == "blocks":
        mask[(np.add.outer(np.arange(800) // 200, np.arange(900) // 225) % 4) == 0] = 0.0
    elif kept == "random half":
        mask[rng.random(mask.shape) < 0.5] = 0.0
    else:
        mask[::2, ::2] = mask[1::2, 1::2] = 0.0
    whole, masked = (
        invert.reconstruct(frames, patch=257, quality="fast", corrections=corrections)
        for corrections in (None, Corrections(mask=mask))
    )
    record, test = masked.estimate.record, masked.speckle_test
    assert abs(record.contrast.square - 1.0) < 3.0 * record.contrast.error + 0.02
    assert abs(test.third_moment_ratio - 1.0) < 4.0 * test.error
    assert not any(one.is_raised for one in masked.doubts)
    assert record.dof_expected == pytest.approx(dof_share * whole.estimate.record.dof_expected, rel=0.1)
    assert masked.confidence > whole.confidence - 0.1


@pytest.mark.parametrize(
    ("option", "array"),
    [
        ("--flat", np.zeros((130, 140))),
        ("--mask", np.zeros((130, 140))),
        ("--mask", np.ones((140, 130))),
        ("--flat", np.full((130, 140), np.nan)),
        ("--dark", np.ones((130, 139))),
    ],
)
def test_corrections_that_do_not_fit_are_refused(tmp_path, rng, option, array):
    np.save(tmp_path / "a.npy", rng.random((130, 140)))
    np.save(tmp_path / "other.npy", array)
    corrections = Corrections(**{option[2:]: tmp_path / "other.npy"})
    with pytest.raises(InputError, match=option):
        corrections.apply(read_capture([tmp_path / "a.npy"], UNKNOWN))


def test_a_pixel_that_saturates_in_the_dark_takes_the_mean(tmp_path, rng):
    frame, dark, flat = rng.random((130, 140)) + 1.0, np.full((130, 140), 0.1), rng.random((130, 140)) + 1.0
    dark[7, 9] = flat[7, 9] = 65535.0
    for name, array in (("a", frame), ("dark", dark), ("flat", flat)):
        np.save(tmp_path / f"{name}.npy", array.astype(np.float32))
    corrections = Corrections(tmp_path / "dark.npy", tmp_path / "flat.npy")
    corrected = corrections.apply(read_capture([tmp_path / "a.npy"], UNKNOWN)).frames[0]
    lit = np.ones(frame.shape, bool)
    lit[7, 9] = False
    gain = np.where(lit, flat - dark, 1.0)
    expected = (frame - dark) / (gain / gain[lit].mean())
    np.testing.assert_allclose(corrected[lit], expected[lit], rtol=1e-5)
    np.testing.assert_allclose(corrected[7, 9], (frame - dark)[lit].mean(), rtol=1e-5)


def test_a_mask_may_be_true_and_false(tmp_path, rng):
    np.save(tmp_path / "a.npy", rng.random((130, 140)))
    mask = rng.random((130, 140)) > 0.3
    np.save(tmp_path / "mask.npy", mask)
    Image.fromarray(mask).save(tmp_path / "mask.png")
    capture = read_capture([tmp_path / "a.npy"], UNKNOWN)
    by_array, by_picture = (
        Corrections(mask=str(tmp_path / f"mask.{kind}")).apply(capture).frames[0] for kind in ("npy", "png")
    )
    assert (by_array == by_picture).all()
    assert (by_array[mask] == capture.frames[0][mask]).all()


def test_files_of_several_types_are_refused(tmp_path, rng):
    np.save(tmp_path / "a.npy", rng.random((130, 140)))
    Image.fromarray(rng.integers(0, 255, (130, 140), np.uint8)).save(tmp_path / "b.png")
    with pytest.raises(InputError, match=r"a\.npy and b\.png"):
        find_frames([tmp_path])


def test_tiff_files_of_every_writer(tmp_path, rng):
    pixels = rng.integers(0, 2000, (130, 140)).astype(np.uint16)
    for kind in ("float64", "float32", "float16", "int16", "uint32"):
        tifffile.imwrite(tmp_path / f"{kind}.tif", pixels.astype(kind))
    tifffile.imwrite(tmp_path / "big.tif", pixels, bigtiff=True)
    for name in ("tiff_lzw", "tiff_adobe_deflate", "packbits"):
        Image.fromarray(pixels).save(tmp_path / f"{name}.tif", compression=name)
    for file in tmp_path.glob("*.tif"):
        assert (read_image(file)[0] == pixels).all(), file.name


def test_a_folder_stands_for_one_kind_of_file(tmp_path, rng):
    write_frame(tmp_path / "frame_0000.exr", rng.random((8, 8)), header())
    np.save(tmp_path / "truth.npy", np.zeros((64, 64)))
    assert [path.name for path in find_frames([tmp_path])] == ["frame_0000.exr"]


def test_refusals(tmp_path, rng):
    good = rng.random((130, 130))

    def assert_refused(match: str, **arrays) -> None:
        paths = []
        for name, array in arrays.items():
            paths.append(tmp_path / f"{name}.npy")
            np.save(paths[-1], array)
        with pytest.raises(InputError, match=match):
            read_capture(paths, UNKNOWN)

    assert_refused("one size", a=good, b=good[:, :129])
    assert_refused("finite", a=np.where(good > 0.999, np.nan, good))
    assert_refused("the same value", a=np.full((130, 130), 7.0))
    assert_refused("a positive mean, found -4.6", a=np.random.default_rng(0).poisson(0.4, (130, 130)) - 5.0)
    assert_refused("monochrome", a=np.dstack([good] * 3))
    assert_refused("repeats", a=good, b=good)
    assert_refused("at least 127", a=good[:100])
    assert_refused("numbers", a=good > 0.5)
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    with pytest.raises(InputError, match="can be read"):
        read_capture([tmp_path / "bad.png"], UNKNOWN)
    np.save(tmp_path / "pickled.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="can be read"):
        read_capture([tmp_path / "pickled.npy"], UNKNOWN)


def test_masked_pixels_and_names_of_other_frames_are_refused(rng):
    frames = rng.poisson(3.0, (3, 130, 130)).astype(np.float32)
    masked = np.ma.array(frames, mask=frames > 5.0)
    for source in (masked, list(masked)):
        with pytest.raises(InputError, match="masked pixels"):
            Capture(source)
        with pytest.raises(InputError, match="masked pixels"):
            read_source(source, UNKNOWN)
    with pytest.raises(InputError, match="3 for 2 frames"):
        Capture(frames[:2], names=("a", "b", "c"))
    assert len(Capture(frames, names=("stack.npy",)).frames) == 3


def test_pictures_that_would_lose_bits_or_transparency_are_refused(tmp_path, rng):
    """Pillow reads 16 bits of a single grey channel only, and the high byte of others."""
    deep = rng.integers(0, 2000, (130, 140)).astype(np.uint16)
    io.imsave(tmp_path / "grey.png", deep, check_contrast=False)
    assert (read_image(tmp_path / "grey.png")[0] == deep).all()
    # A PNG file of three channels of 16 bits, as cameras' programs write them.
    rows = np.repeat(deep[..., None], 3, 2).astype(">u2")
    body = b"".join(b"\0" + row.tobytes() for row in rows)
    parts = [(b"IHDR", struct.pack(">IIBBBBB", 140, 130, 16, 2, 0, 0, 0)), (b"IDAT", zlib.compress(body)), (b"IEND", b"")]
    chunks = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    (tmp_path / "three.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    with pytest.raises(InputError, match=r"3 channels of 16 bits in three\.png"):
        read_image(tmp_path / "three.png")
    white = np.full((130, 140, 4), 255, np.uint8)
    Image.fromarray(white).save(tmp_path / "opaque.png")
    assert (read_image(tmp_path / "opaque.png")[0] == 255.0).all()
    white[:60, :, 3] = 0
    Image.fromarray(white).save(tmp_path / "transparent.png")
    with pytest.raises(InputError, match="monochrome"):
        read_image(tmp_path / "transparent.png")


def test_frames_of_two_captures_are_refused(tmp_path, rng):
    write_frame(tmp_path / "a.exr", rng.random((130, 130)), header())
    write_frame(tmp_path / "b.exr", rng.random((130, 130)), header(distance_m=2.0))
    with pytest.raises(InputError, match="one capture"):
        read_capture([tmp_path], UNKNOWN)


def test_published_autocorrelations_are_read_as_their_left_half(tmp_path, rng):
    half = rng.integers(0, 255, (127, 127))
    half = (half + half[::-1, ::-1]) // 2
    Image.fromarray(np.hstack([half, half * 0 + 9]).astype(np.uint8)).save(tmp_path / "a.png")
    lags, step = read_autocorrelation(tmp_path / "a.png")
    assert np.array_equal(lags, half)
    assert step == 1.0
    Image.fromarray(np.roll(half, 3, 0).astype(np.uint8)).save(tmp_path / "off.png")
    with pytest.raises(InputError, match="centro-symmetric"):
        read_autocorrelation(tmp_path / "off.png")
    Image.fromarray(half[:, :126].astype(np.uint8)).save(tmp_path / "small.png")
    with pytest.raises(InputError, match="127 x 127"):
        read_autocorrelation(tmp_path / "small.png")


def test_inverting_never_imports_mitsuba():
    code = (
        "import sys, invert.__main__, invert.output.result_files, invert.methods; "
        "import invert.measure.estimate, invert.albedo.metrics; "
        "sys.exit(int('mitsuba' in sys.modules or 'drjit' in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_files_of_several_frames_and_inverted_files_are_refused(tmp_path, rng):
    pixels = rng.integers(0, 2000, (130, 140)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "stack.tif", np.stack([pixels, pixels]))
    with tifffile.TiffWriter(tmp_path / "pages.tif") as writer:
        writer.write(pixels)
        writer.write(pixels[:129])
    tifffile.imwrite(tmp_path / "inverted.tif", pixels, photometric="miniswhite")
    (tmp_path / "turned.tif").write_bytes(b"")
    tifffile.imwrite(tmp_path / "turned.tif", pixels, extratags=[(274, 3, 1, 6, True)])
    (tmp_path / "named.png").write_bytes((tmp_path / "stack.tif").read_bytes())
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Y": pixels.astype(np.float32)}, name=name) for name in "ab"]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    for name in ("stack.tif", "pages.tif", "inverted.tif", "turned.tif", "named.png", "parts.exr"):
        with pytest.raises(InputError):
            read_image(tmp_path / name)


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("nowhere")])
def test_entries_that_are_no_files_are_refused(tmp_path, rng, make):
    np.save(tmp_path / "a.npy", rng.random((130, 140)))
    make(tmp_path / "b.npy")
    with pytest.raises(InputError, match=r"b\.npy"):
        find_frames([tmp_path])


def test_pictures_of_other_types_are_named(tmp_path, rng, capsys):
    for name in ("a", "b"):
        np.save(tmp_path / f"{name}.npy", rng.poisson(3.0, (300, 300)).astype(np.float32))
    for name in ("c.jpg", "d.BMP"):
        (tmp_path / name).touch()
    assert len(read_capture([tmp_path], CameraMetadata()).frames) == 2
    assert capsys.readouterr().err.startswith("skipped c.jpg and 1 more in ")
