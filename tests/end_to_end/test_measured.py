"""Published lab autocorrelations: the letters come out, and their noise follows the model."""

import json

import numpy as np
import pytest

from invert.__main__ import main as invert
from invert.capture import read_autocorrelation
from invert.identification import identify
from radiometry.noise_level import read_noise_level


@pytest.mark.slow
@pytest.mark.parametrize(("method", "letter"), [
    ("classical", "F"), ("classical", "7"), ("classical", "t"), ("unet", "F"), ("unet", "7"), ("unet", "t")])
def test_a_measured_letter_is_recognised(measured, tmp_path, method, letter):
    """Its own template beats every other letter and digit. The lab's camera sees the wall mirrored."""
    invert(["--autocorrelation", str(measured / f"{letter}_n50_corr_x100_nzero1.png"), "-o", str(tmp_path), "--method", method])
    assert json.loads((tmp_path / "result.json").read_text())["object_found"]
    ranking = identify(np.load(tmp_path / "albedo.npy"), mirrored=True)
    assert ranking[0][0] == letter, ranking[:3]


@pytest.mark.parametrize("letter", ["5", "7", "F", "t"])
@pytest.mark.parametrize("patches", [1, 2, 3, 5, 10, 25])
def test_dof_of_measured_estimates(measured, letter, patches):
    """K = patches x (frames - 1); one K of a single file is known to sqrt(2 / 4000) at best."""
    lags, step = read_autocorrelation(measured / f"{letter}_n2_corr_x100_nzero1_npatch{patches}.png")
    assert read_noise_level(lags, step).dof == pytest.approx(patches, rel=0.15)


def test_dof_of_the_exposure_series(measured):
    """64 patches of two frames at every exposure, the row of read noise at the short ones included."""
    for path in sorted(measured.glob("lowExp_7_2_*_npatch64.png")):
        lags, step = read_autocorrelation(path)
        assert read_noise_level(lags, step).dof == pytest.approx(64, rel=0.15), path.name
