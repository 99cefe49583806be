"""Published lab autocorrelations: the letters come out, and their noise follows the model."""

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

import correlograph as cg
from correlograph.files.images import read_autocorrelation
from correlograph.lags import LAGS, lag_grid
from invert.choices import FAST, UNET
from invert.evaluation.identification import identify
from invert.measure.spectrum import read_measurement
from invert.methods import reconstructor
from radiometry.noise.measured_noise import read_noise_level
from radiometry.noise.model import autocorrelate_windowed, log_likelihood

RING = lag_grid(LAGS).ring


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "letter"),
    [("classical", "F"), ("classical", "7"), ("classical", "t"), ("unet", "F"), ("unet", "7"), ("unet", "t")],
)
def test_a_measured_letter_is_recognised(measured, method, letter):
    """The most confident of four reconstructions correlates better with its own template than with any other letter or digit.

    The camera of the lab sees the wall mirrored. Phase retrieval is chaotic: single seeds of the classical t show an r or a 7.
    """
    file = measured / f"{letter}_n50_corr_x100_nzero1.png"
    results = [cg.reconstruct(file, method=method, seed=seed) for seed in range(4)]
    assert all(result.object_found for result in results)
    best = max(results, key=lambda result: result.confidence)
    ranked = [template for template, _ in identify(best.albedo, mirrored=True)]
    assert ranked[0] == letter, ranked[:3]


@pytest.mark.slow
@pytest.mark.parametrize("letter", ["5", "7", "F", "t"])
def test_the_lab_has_a_pedestal(measured, letter):
    """Over the floor and the drawn object's r*r there is an excess some 30 lags wide, 1 to 6 % high, not a mere offset."""
    shown = read_measurement(*read_autocorrelation(measured / f"{letter}_n50_corr_x100_nzero1.png"))
    # As the fusion draws it: samples and likelihood ascent add a faint background that explains a part of the pedestal.
    albedo = torch.from_numpy(reconstructor(UNET, FAST).run(shown).albedo).double()
    used, lag = torch.from_numpy(RING > 1), torch.arange(-63, 64).double()
    estimate = torch.from_numpy(shown.values).double().where(used, 1.0)
    signal = autocorrelate_windowed(albedo) / autocorrelate_windowed(albedo)[used].max()

    def likeliest(pedestal_lags: float | None) -> tuple[float, float]:
        def cost(heights: np.ndarray) -> float:
            expected = shown.noise.floor + float(heights[0]) * signal
            if pedestal_lags:
                expected = expected + float(heights[1]) * torch.exp(-(lag[:, None] ** 2 + lag**2) / (2.0 * pedestal_lags**2))
            return -float(log_likelihood(estimate, expected.where(used, 1.0), shown.noise.dof))

        found = minimize(cost, (150.0, 3.0), method="Nelder-Mead", bounds=((1.0, 400.0), (0.0, 50.0)))
        return -found.fun, found.x[1] / found.x[0]

    (without, _), (narrow, _), (wide, height), (offset, _) = map(likeliest, (None, 8.0, 30.0, 1e4))
    assert wide - without > 10_000.0
    assert wide - max(narrow, offset) > 3000.0
    assert 0.01 < height < 0.06


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
