"""`Field`: propagation to the wall, refocusing, files."""

import numpy as np
import pytest

import correlograph as cg
from correlograph.errors import InputError


@pytest.fixture
def field(rng):
    samples = (rng.standard_normal((2, 40, 55)) + 1j * rng.standard_normal((2, 40, 55))).astype(np.complex64)
    return cg.Field(samples, (128, 150), (120, 140), (40e-6, 33e-6), 532e-9, 1.0)


def test_the_wall_has_the_power_of_the_object(field):
    whole = cg.Field(field.samples, field.wall_shape, field.wall_shape)
    assert (np.abs(whole.on_wall()) ** 2).sum() == pytest.approx((np.abs(field.samples) ** 2).sum(), rel=1e-5)
    assert field.on_wall().shape == (2, 120, 140)


def test_refocusing_moves_a_point_to_its_plane():
    """A point behind the plane has a quadratic phase on the wall; refocusing by its depth makes it a point again."""
    depth, shape = 0.02, (128, 150)
    samples = np.zeros((1, 64, 64), np.complex64)
    samples[0, 30, 33] = 1.0
    sharp = cg.Field(samples, shape, shape, (40e-6, 33e-6), 532e-9, 1.0)
    blurred = sharp.refocus(-depth)
    assert np.abs(blurred.samples).max() < 0.7
    peaks = {found: np.abs(blurred.refocus(found).samples).max() for found in (-depth, 0.0, 0.5 * depth, depth)}
    assert max(peaks, key=peaks.get) == depth
    # The point is blurred by depth times the angle of the frame: lambda z / cell over z.
    spread = np.abs(blurred.samples[0]) ** 2
    width = np.sqrt((spread.sum(1) * (np.arange(64) - 30) ** 2).sum() / spread.sum()) * 40e-6
    assert width == pytest.approx(depth * 532e-9 / 40e-6 / 12**0.5, rel=0.3)


def test_files_and_combination(field, tmp_path):
    field.save(tmp_path / "fields.npz")
    loaded = cg.Field.load(tmp_path / "fields.npz")
    assert np.array_equal(loaded.samples, field.samples)
    assert (loaded.wall_shape, loaded.pitches_m, loaded.distance_m) == (field.wall_shape, field.pitches_m, field.distance_m)
    assert len(field.combine(loaded)) == 4
    with pytest.raises(InputError, match="same cells"):
        field.combine(cg.Field(field.samples[:, :30], field.wall_shape, field.frame_shape))


def test_unusable_fields_are_refused(field, tmp_path):
    for samples in (field.samples.real, field.samples[0], field.samples * np.nan):
        with pytest.raises(InputError, match="field"):
            cg.Field(samples, (128, 150), (120, 140))
    with pytest.raises(InputError, match="known camera"):
        cg.Field(field.samples, (128, 150), (120, 140)).refocus(0.001)
    with pytest.raises(InputError, match="tenth of the distance"):
        field.refocus(0.5)
    (tmp_path / "fields.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"fields\.npz"):
        cg.Field.load(tmp_path / "fields.npz")
    np.savez(tmp_path / "other.npz", samples=field.samples)
    with pytest.raises(InputError, match=r"fields\.npz"):
        cg.Field.load(tmp_path / "other.npz")
