"""Tracks of hidden objects from frames with the laser at rest."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral

import numpy as np
from tqdm import tqdm

from correlograph.errors import InputError, check_positive
from correlograph.files.capture import Capture
from correlograph.files.captured_frames import check_copies, check_frames_in_memory, check_range
from invert.tracking.band import Band
from invert.tracking.breaks import check_continuity, follow_over_jumps
from invert.tracking.central_lobe import central_lobe
from invert.tracking.drawn import add_drawn
from invert.tracking.joint import follow_several
from invert.tracking.light import at_even_power
from invert.tracking.numbers import doubts_of_order, frame_numbers
from invert.tracking.pursuit import fading_along, find_objects, is_alone
from invert.tracking.shutter import fading_along_steps, for_open_shutter
from invert.tracking.spectra import Reader, frames_in_memory
from invert.tracking.strange import interpolate
from invert.tracking.tables import check_frames, exposure_of
from invert.tracking.to_object import metres_per_pixel, stretch_by_illumination
from invert.tracking.track import Track

MAX_STEP_SHARE = 0.4
"""Largest displacement from frame to frame, over a side."""

MIN_SIDE = 16
"""Minimum side of a frame in pixels after binning."""


def track(
    capture: Capture,
    *,
    source_distance_m: float | None = None,
    source_angle_deg: tuple[float, float] = (0.0, 0.0),
    interval_s: float | None = None,
    binning: int = 1,
) -> Track:
    """Find the motion of the speckle over the frames of a capture with the laser at rest.

    Args:
        source_distance_m: distance from the laser spot to the object; with the metadata of the camera, displacements of the object follow.
        source_angle_deg: angles between the light from the spot and the line of sight, along rows and columns.
        interval_s: time between the starts of two frames. With the exposure of the frames, it corrects what an open shutter draws
            displacements of a single object towards zero by.
        binning: pixels that are added along each axis before the comparison; grains should stay wider than two of them.

    Raises InputError for fewer than three frames, and for frames without common motion.
    """
    if np.shape(source_angle_deg) != (2,) or np.asarray(source_angle_deg).dtype.kind not in "uif":
        raise InputError("source_angle_deg", "two angles, along rows and columns", repr(source_angle_deg), "give both")
    if source_distance_m is not None:
        check_positive("source_distance_m", source_distance_m)
    elif any(source_angle_deg):
        raise InputError("source_angle_deg", "source_distance_m with it", "an angle alone", "give both")
    check_frames(capture, interval_s, 3, "path")
    numbers = frame_numbers(capture)
    lever = None if source_distance_m is None else metres_per_pixel(capture.camera, source_distance_m, source_angle_deg)
    spectra, band = _read_spectra(capture, binning)
    starts = find_objects(at_even_power(spectra, band), band)
    for one in starts:
        _check_steps(one.path, band)
    alone = is_alone(starts)
    followed = (
        [follow_over_jumps(spectra, band, starts[0])]
        if alone
        else add_drawn(spectra, band, follow_several(spectra, band, starts))
    )
    if len(starts) == 1 and not starts[0].is_continuous:
        check_continuity(spectra, band if alone else central_lobe(band), followed[0].path)
    open_share, tracks = _open_share(capture, interval_s), []
    for start, one in zip(starts, followed, strict=True):
        its_band = replace(band, signal=one.power)
        if one.interpolated:
            path, error = interpolate(one.path, one.error, numbers, one.interpolated)
            one = replace(one, path=path, error=error)
        if alone and open_share and one.significance:
            one = replace(one, fading=fading_along_steps(spectra, band, one.path, open_share))
        opened = for_open_shutter(one, its_band, open_share, np.diff(numbers))
        stretch = None if lever is None else stretch_by_illumination(its_band, capture.camera, binning)
        found = Track(
            opened.path * binning,
            opened.error * binning,
            start.significance,
            start.share,
            frames_per_position=opened.frames_per_group,
            metres_per_pixel=lever,
            interval_s=interval_s,
            noise=replace(opened.noise, of_pair=opened.noise.of_pair * binning**2),
            in_common=one.in_common,
            stretch=stretch,
            fading=fading_along(spectra, band, one.path) if alone else None,
            shortened=opened.shortened,
            numbers=numbers,
            interpolated=one.interpolated,
            order=tuple(doubts_of_order(capture.names)),
            grains=its_band.cells,
        )
        tracks.append(found)
    return replace(tracks[0], others=tuple(tracks[1:]))


def _check_steps(path: np.ndarray, band: Band) -> None:
    """Raise InputError for a path (frames, 2) that could as well be one shorter by a side of the frame per step: spectra do not tell them
    apart."""
    steps = np.median(np.abs(np.diff(path, axis=0)), axis=0)
    if (steps > MAX_STEP_SHARE * np.array(band.shape)).any():
        expected = "speckle that moves by at most {:.0f} rows and {:.0f} columns per frame".format(
            *(MAX_STEP_SHARE * side for side in band.shape)
        )
        raise InputError("frames", expected, "{:.0f} and {:.0f}, or a side more or less".format(*steps), "shorten the interval")


def _read_spectra(capture: Capture, binning: int) -> tuple[np.ndarray, Band]:
    """Return the spectra of all frames, (frames, R, C), and their band. Raises InputError for frames that are not finite, show no speckle,
    or are copies."""
    rows, columns = capture.frames[0].shape
    most = min(rows, columns) // MIN_SIDE
    if not isinstance(binning, Integral) or not 1 <= binning <= most:
        expected = f"a whole number from 1 to {most} for frames of {rows} x {columns} pixels"
        raise InputError("binning", expected, binning, "bin less, or use larger frames")
    check_frames_in_memory(capture.frames, check_range)
    reader = Reader((rows, columns), binning)
    band = reader.band(capture.frames)
    if band is None:
        expected, remedy = "speckle that moves as a whole", "add light, or bin less"
        raise InputError("frames", expected, "no speckle above the noise", remedy)
    if len(capture.frames) > (largest := frames_in_memory(band)):
        raise InputError("frames", f"at most {largest} in this memory", len(capture.frames), "track them in parts")
    with tqdm(total=len(capture.frames), desc="frames", unit="frame", disable=None, leave=False) as bar:
        spectra = reader.all_spectra(capture.frames, band, bar.update)
    check_copies(spectra)
    return spectra, band


def _open_share(capture: Capture, interval_s: float | None) -> float:
    """Return the share of the interval between frames in which the shutter is open; 0 if it is unknown."""
    exposure_s = exposure_of(capture)
    return 0.0 if exposure_s is None or interval_s is None else min(exposure_s / interval_s, 1.0)
