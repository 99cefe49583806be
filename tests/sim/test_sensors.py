"""Photon-counting cameras and cameras with polarisation channels against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from correlograph.errors import InputError
from radiometry.noise.predicted_floor import NoiseTerms
from radiometry.prediction import predict
from radiometry.sensor.chain import expose
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import SpeckleLight
from sim.frame import Simulation
from sim.plan import Settings

TWO_CHANNELS = ('<float name="exposure"', '<float name="polarisation_channels" value="2"/><float name="exposure"')


@pytest.mark.parametrize("occupancy", [0.05, 0.7, 3.0])
def test_counts_of_speckle_have_the_moments_in_closed_form(occupancy):
    """x exponential of mean mu per gate: E[exp(-x)] = 1 / (1 + mu), so the contrast^2 of the mean counts is 1 / (1 + 2 mu)."""
    gates, rng = 40, np.random.default_rng(5)
    mean = rng.exponential(occupancy * gates, 400_000)
    camera = Electronics(1.0, gate=1.0 / gates)
    counts, expected = (expose(mean[None], one, rng) for one in (camera, replace(camera, shot_noise=False)))
    assert counts.max() <= gates
    assert expected.mean() == pytest.approx(gates * occupancy / (1.0 + occupancy), rel=0.01)
    assert expected.var() / expected.mean() ** 2 == pytest.approx(1.0 / (1.0 + 2.0 * occupancy), rel=0.02)
    noise = gates * occupancy / ((1.0 + occupancy) * (1.0 + 2.0 * occupancy))
    assert counts.var() - expected.var() == pytest.approx(noise, rel=0.06)


@pytest.mark.parametrize("modes", [1.0, 2.0])
@pytest.mark.parametrize(("signal", "other"), [(1e-6, 0.0), (0.5, 2.0), (30.0, 6.0)])
def test_the_floor_of_counts_is_that_of_samples(modes, signal, other):
    gates = 20.0
    terms = NoiseTerms(SpeckleLight(signal, 100.0 / modes, other, modes=modes), Electronics(1.0, gate=1.0 / gates))
    # Moments of the binomial counts over the Gamma distribution of the signal, by quadrature.
    node, weight = np.polynomial.laguerre.laggauss(120)
    weight = weight * node ** (modes - 1.0)
    weight /= weight.sum()
    detected = -np.expm1(-(node / modes * signal + other) / gates)
    mean = float(weight @ detected)
    variance = float(weight @ (detected - mean) ** 2)
    noise = float(weight @ (detected * (1.0 - detected)))
    assert terms.floor_over_peak() == pytest.approx(noise / (gates * variance * 100.0), rel=2e-3)


def test_few_photons_are_counted_without_loss():
    gated, plain = (
        NoiseTerms(SpeckleLight(0.01, 100.0), Electronics(1.0, dark_current=0.02, gate=gate)) for gate in (1e-6, 0.0)
    )
    assert gated.floor_over_peak() == pytest.approx(plain.floor_over_peak(), rel=1e-3)


def test_rendered_counts_have_the_noise_in_closed_form(scene):
    """Half a photon on average in a single gate: a third of the pixels count one, with a noise of mu / ((1 + mu) (1 + 2 mu))."""
    geometry = scene()
    exposure_s = geometry.camera.electronics.exposure_s * 0.5 / predict(geometry).terms.light.signal
    geometry = geometry.with_electronics(exposure_s=exposure_s, gate=exposure_s)
    simulation = Simulation(geometry, Settings(effects=(("detector_roughness", False),)))
    frame, expected = simulation.frame(1, 0).numpy(), simulation.expected_frame(1, 0).numpy()
    assert set(np.unique(frame)) == {0.0, 1.0}
    assert frame.mean() == pytest.approx(1.0 / 3.0, rel=0.06)  # pupil and pixel lower the contrast, which raises the mean
    noise = (frame - -np.expm1(-expected)).var()
    assert noise == pytest.approx(0.5 / (1.5 * 2.0), rel=0.06)
    terms = predict(geometry).terms
    assert terms.over_peak()["signal"] + terms.over_peak()["photon_counting"] == pytest.approx(
        1.5 * terms.over_peak()["signal"], rel=1e-6
    )


def test_polarisation_channels_double_k_at_an_equal_floor(scene, depolarising):
    """Each channel holds half of the light at full contrast: floor over peak 1 / (m / 2 A) equals that of both, 1 / (m A / 2)."""
    both, single = scene(depolarising), scene(depolarising, TWO_CHANNELS)
    assert both.is_depolarised
    assert not single.is_depolarised
    mixed, channel = predict(both), predict(single)
    assert channel.terms.light.signal == pytest.approx(0.5 * mixed.terms.light.signal, rel=1e-6)
    assert channel.terms.over_peak()["signal"] == pytest.approx(mixed.terms.over_peak()["signal"], rel=1e-6)
    exposures = 3
    assert channel.dof(2 * exposures) == pytest.approx(2.0 * mixed.dof(exposures), rel=0.35)
    quiet = Settings(effects=(("shot_noise", False), ("detector_roughness", False)))
    one, two = (Simulation(geometry, quiet) for geometry in (both, single))
    seen = [two.expected_frame(4, number).numpy() for number in range(4)]
    contrast = [(image.std() / image.mean()) ** 2 for image in seen]
    image = one.expected_frame(4, 0).numpy()
    assert np.mean(contrast) / (image.std() / image.mean()) ** 2 == pytest.approx(2.0, rel=0.12)
    assert abs(np.corrcoef(seen[0].ravel(), seen[1].ravel())[0, 1]) < 0.05
    # Both channels of an exposure together are the frame of a camera without channels.
    np.testing.assert_allclose(seen[0] + seen[1], image, rtol=1e-3, atol=1e-4 * image.mean())


def test_impossible_sensors_are_refused(scene):
    with pytest.raises(InputError, match="depolarising"):
        scene(TWO_CHANNELS)
    for gate in (0.2, 1e-20):
        with pytest.raises(InputError, match="gate"):
            Electronics(exposure_s=0.1, gate=gate)
    with pytest.raises(InputError, match=r"a gate that divides the exposure of 0.125 s, found 0.05; set gate to 0.0625"):
        scene(('<float name="exposure"', '<float name="gate" value="0.05"/><float name="exposure"'))
    assert Electronics(exposure_s=0.1, gate=0.01).gates == 10.0
    assert math.isclose(Electronics(exposure_s=0.1).gates, 0.0)
