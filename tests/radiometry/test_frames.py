"""Frame files: what goes in comes out, and the header is the contract's."""

import numpy as np
import OpenEXR
import pytest

from correlograph.errors import InputError
from correlograph.files.exr_frames import FrameHeader, read_frame, write_frame

HEADER = FrameHeader(532e-9, 6.9e-6, 1.0, 0.125, 3, 1, "ab" * 32, "1.2.3", 0.0514, 0.54)


def test_round_trip(tmp_path, rng):
    pixels = rng.poisson(0.7, (37, 53)).astype(np.float32)
    write_frame(tmp_path / "frame.exr", pixels, HEADER)
    back, header = read_frame(tmp_path / "frame.exr")
    assert np.array_equal(back, pixels)
    assert header is not None
    for name, value in vars(HEADER).items():
        assert getattr(header, name) == (pytest.approx(value) if isinstance(value, float) else value), name
    assert [path.name for path in tmp_path.glob("[!.]*")] == ["frame.exr"]


def test_other_programs_read_it(tmp_path, rng):
    mi = pytest.importorskip("mitsuba")
    if mi.variant() is None:
        mi.set_variant("llvm_ad_mono")
    pixels = rng.poisson(5.0, (40, 21)).astype(np.float32)
    write_frame(tmp_path / "frame.exr", pixels, HEADER)
    with OpenEXR.File(str(tmp_path / "frame.exr"), separate_channels=True) as file:
        assert list(file.channels()) == ["photoelectrons"]
        assert file.header()["distance_m"] == 1.0
    bitmap = mi.Bitmap(str(tmp_path / "frame.exr"))
    assert bitmap.metadata()["version"] == "1.2.3"
    assert np.array_equal(np.array(bitmap).reshape(40, 21), pixels)


@pytest.mark.parametrize("keep", [0, 5, 100, 700, 3000])
def test_truncated_files_are_one_clear_error(tmp_path, rng, capfd, keep):
    write_frame(tmp_path / "whole.exr", rng.random((64, 64)).astype(np.float32), HEADER)
    (tmp_path / "cut.exr").write_bytes((tmp_path / "whole.exr").read_bytes()[:keep])
    with pytest.raises(InputError, match=r"cut\.exr"):
        read_frame(tmp_path / "cut.exr")
    assert capfd.readouterr() == ("", "")


def test_colour_is_refused(tmp_path):
    plane = np.zeros((8, 8), np.float32)
    OpenEXR.File(
        {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"R": plane, "G": plane, "B": plane}
    ).write(str(tmp_path / "rgb.exr"))
    with pytest.raises(InputError, match="one channel"):
        read_frame(tmp_path / "rgb.exr")


def test_a_failed_write_leaves_nothing(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(InputError, match="taken"):
        write_frame(tmp_path / "taken", np.zeros((4, 4), np.float32), HEADER)
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
