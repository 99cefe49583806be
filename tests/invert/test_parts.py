"""Spectra in parts, on any number of cores, give the sums of the whole."""

import numpy as np
import pytest
import torch

import correlograph as cg
from invert.tracking import parts
from invert.tracking.parts import on_all_cores, sum_over_rows
from invert.tracking.tracker import track
from tests.invert.field.speckle import letter, travelling_frames


@pytest.mark.parametrize("part_bytes", [1, 3000, 10**9])
def test_parts_add_up_to_the_whole(rng, part_bytes, monkeypatch):
    """Sizes of parts that do not divide the rows, and an array of more than one number per part."""
    monkeypatch.setattr(parts, "PART_BYTES", part_bytes)
    spectra = (rng.standard_normal((7, 23, 10)) + 1j * rng.standard_normal((7, 23, 10))).astype(np.complex64)
    rows = np.arange(23.0)
    found = sum_over_rows(lambda part: np.einsum("nrc,r->n", spectra[:, part], rows[part]), spectra)
    np.testing.assert_allclose(found, np.einsum("nrc,r->n", spectra, rows), rtol=1e-4)


def test_the_number_of_cores_changes_nothing(rng, monkeypatch):
    spectra, totals = rng.standard_normal((5, 900, 700)).astype(np.float32), []
    for cores in (1, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda cores=cores: cores)
        totals.append(sum_over_rows(lambda part: (spectra[:, part] ** 3).sum((1, 2)), spectra))
    np.testing.assert_array_equal(*totals)


def test_a_path_is_the_same_on_any_number_of_cores(rng, monkeypatch):
    path = np.arange(12)[:, None] * np.array([2.0, -1.0])
    frames = [rng.poisson(0.5 * one) for one in travelling_frames(letter(), (300, 340), 128, rng, path, 60.0)]
    found = []
    for cores in (1, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda cores=cores: cores)
        found.append(track(cg.Capture(frames)).path_pixels)
    np.testing.assert_array_equal(*found)


def test_results_keep_their_order_and_errors_arrive(monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    assert on_all_cores(lambda number: number**2, range(50)) == [number**2 for number in range(50)]
    with pytest.raises(ZeroDivisionError):
        on_all_cores(lambda number: 1 // (3 - number), range(9))
