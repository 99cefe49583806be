"""Images turned about their middle, in units of length."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def turn(image: np.ndarray, angle_deg: float, aspect: float = 1.0, outside: float = 0.0) -> np.ndarray:
    """Return an image (n, n) turned anticlockwise as it is displayed, float32.

    Args:
        aspect: pitch of rows over that of columns.
        outside: value of pixels that lay outside.
    """
    if angle_deg == 0.0:
        return image.astype(np.float32)
    turned, middle = np.radians(angle_deg), 0.5 * (np.array(image.shape) - 1.0)
    rotation = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
    back = np.diag([1.0 / aspect, 1.0]) @ rotation @ np.diag([aspect, 1.0])
    return ndimage.affine_transform(image.astype(np.float64), back, middle - back @ middle, order=3, cval=outside).astype(
        np.float32
    )
