"""Speckle of the laser on the object: its grains, and the places in it of a point of the object."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from sim.geometry import Geometry


def grain_m(geometry: Geometry) -> float:
    """Return the size of a speckle grain on the object, lambda d / D: d from the laser spot to the object, D the diameter of the spot (van
    Cittert-Zernike)."""
    return geometry.wavelength_m * geometry.source_distance_m / geometry.spot.diameter_m


def along_axes(geometry: Geometry, displacement: np.ndarray) -> np.ndarray:
    """Return displacements in the world (..., 3) along the object's axes: rows, columns and line of sight."""
    hidden = geometry.hidden_object
    return np.concatenate([hidden.axes.coordinates(displacement), (displacement @ hidden.line_of_sight)[..., None]], -1)


def lit_matrix(geometry: Geometry) -> np.ndarray:
    """Return the matrix (2, 3) from places along the object's axes to those in the laser's speckle, whose grains are lambda d1 / D wide.

    Spot and object see each other across the ray between them: with its direction r, a place x in the light of a point s of the spot has
    the phase 2 pi s (1 - r r^T) x / (lambda d1). The axes of the spot are turned so that displacements along the rows of the grid move
    along the first one only: element (1, 0) is zero.
    """
    hidden, spot = geometry.hidden_object, geometry.spot
    ray = hidden.centre - spot.centre
    ray = ray / np.linalg.norm(ray)
    first = np.cross(
        spot.normal, [0.0, 1.0, 0.0] if abs(spot.normal[0]) > 0.5 * np.linalg.norm(spot.normal) else [1.0, 0.0, 0.0]
    )
    axes = np.stack([first, np.cross(spot.normal, first)])
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    seen = axes @ (np.eye(3) - np.outer(ray, ray)) @ np.stack([hidden.axes.down, hidden.axes.right, hidden.line_of_sight], 1)
    turn, _ = np.linalg.qr(seen[:, :2])
    return turn.T @ seen


def lit_place(geometry: Geometry, places: np.ndarray) -> np.ndarray:
    """Return the places in the laser's speckle (..., 2) of places along the object's axes (..., 3); see `lit_matrix`."""
    return places @ lit_matrix(geometry).T
