"""Table of cameras: binning in closed form, efficiencies, and files of users."""

import pytest

from correlograph.errors import InputError
from radiometry.cameras import read_cameras

HEADER = (
    "name,pixel_um,columns,rows,read_noise_e,dark_current_e_per_s,full_well_e,charge_binning,efficiency_500,efficiency_600\n"
)


def table(folder, line, header=HEADER):
    path = folder / "mine.csv"
    path.write_text(header + line + "\n")
    return path


def test_binning_adds_charge_or_numbers(tmp_path):
    line = "A,3,1001,700,2,0.5,9000,{},0.4,0.8"
    charge, numbers = (read_cameras(table(tmp_path, line.format(answer)))[0].bin_pixels(3) for answer in ("yes", "no"))
    assert (charge.read_noise, numbers.read_noise) == (2.0, 6.0)  # the variances of nine readings add up
    for camera in (charge, numbers):
        assert camera.pixel_m == pytest.approx(9e-6)
        assert camera.shape == (233, 333)
        assert camera.dark_current == pytest.approx(4.5)
    assert (charge.full_well, numbers.full_well) == (9000.0, 81000.0)


def test_the_efficiency_is_interpolated_and_never_extrapolated(tmp_path):
    camera = read_cameras(table(tmp_path, "A,3,1000,700,2,0.5,9000,no,0.4,0.8"))[0]
    assert camera.efficiency(525e-9) == pytest.approx(0.5)
    with pytest.raises(InputError, match="500 to 600 nm"):
        camera.efficiency(650e-9)


@pytest.mark.parametrize(
    ("line", "header", "says"),
    [
        ("A,3,1000,700,two,0.5,9000,no,0.4,0.8", HEADER, r"read_noise_e .*camera 1"),
        ("A,3,1000,700.5,2,0.5,9000,no,0.4,0.8", HEADER, "rows"),
        ("A,nan,1000,700,2,0.5,9000,no,0.4,0.8", HEADER, "pixel_um"),
        ("A,3,1000,700,2,0.5,9000,no,0.4,1.8", HEADER, "efficiency_600"),
        ("A,3,1000,700,2,0.5,9000,no", HEADER, "efficiency_500"),
        ("A,3", "name,pixel_um\n", "columns"),
        ("", HEADER, "at least one camera"),
    ],
)
def test_damaged_tables_are_refused(tmp_path, line, header, says):
    with pytest.raises(InputError, match=says):
        read_cameras(table(tmp_path, line, header))


def test_the_shipped_table_is_readable():
    cameras = read_cameras()
    assert len({camera.name for camera in cameras}) == len(cameras) > 5
    assert all(0.3 < camera.efficiency(532e-9) < 1.0 for camera in cameras)
