"""Images of a film in one orientation and place, which r*r leaves open: each may be shifted, and turned by 180 degrees."""

from __future__ import annotations

import numpy as np
import torch

from invert.albedo.registration import correlation_maps, crop_centred, rotate_180, zero_pad


def register_sequence(albedos: np.ndarray) -> np.ndarray:
    """Return albedos (n, H, H) turned like the first, each shifted to fit the one before, in the window that holds most of their light.

    An image that is nearly symmetric tells little of its orientation, and from one to the next, errors would add up. All pairs decide
    together: the signs of the leading eigenvector of the difference of likenesses without and with a half turn.
    """
    padded = zero_pad(torch.from_numpy(np.ascontiguousarray(albedos, np.float32)))
    likeness = torch.stack([correlation_maps(padded, one).amax((-2, -1)) for one in padded])
    difference = likeness[..., 0] - likeness[..., 1]
    leading = torch.linalg.eigh(difference + difference.T)[1][:, -1]
    side, found = albedos.shape[-1], [padded[0]]
    for one, sign in zip(padded[1:], leading[1:], strict=True):
        turned = rotate_180(one) if sign * leading[0] < 0.0 else one
        place = int(correlation_maps(turned[None], found[-1])[0, 0].argmax())
        found.append(torch.roll(turned, divmod(place, 2 * side), (0, 1)))
    return crop_centred(torch.stack(found), side).numpy()
