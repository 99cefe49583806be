"""Output files of a reconstruction: arrays, figures and result.json; and the truth to compare with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from correlograph.files.figures import save_figure
from correlograph.files.output import replace_files, save_array, save_json, staging_folder
from invert.albedo.posterior import SIZES, Samples
from invert.measure.estimate import Estimate
from invert.output.outcome import Outcome
from invert.output.report import draw_report, save_image
from invert.output.truth import Comparison, Truth
from radiometry.autocorrelation import autocorrelate, peak_of_cell_means, smooth_by_window
from radiometry.noise.measured_noise import fit_known_signal

FIELD_FILES = ("albedo_coarse.npy", "deviation.npy", "fields.npz")
"""Files of a result with fields; fields.npz is written on request."""

RESULT_FILES = ("albedo.npy", "albedo.png", "autocorrelation.npy", "report.png", "result.json", "samples.npy", *FIELD_FILES)
"""Names of the files of a result; a result without a posterior has no samples.npy."""


def expected_files(summary: dict[str, Any]) -> list[str]:
    """Return the names of the files that a complete result has beside its result.json with this content."""
    fields = summary.get("fields") or {}
    optional = {
        "samples.npy": summary["posterior"] is not None,
        "albedo_coarse.npy": bool(fields),
        "deviation.npy": fields.get("agreement") is not None,
        "fields.npz": fields.get("saved", False),
    }
    return [name for name in RESULT_FILES if optional.get(name, True)]


def write_result(
    folder: Path, result: Outcome, truth: Truth | np.ndarray | None, request_sha256: str | None, *, fields: bool = False
) -> dict[str, Any]:
    """Write the arrays, the figures and result.json, which replace an earlier result as a whole; return the content of result.json.

    With a truth, the report shows the registered albedo, and the ratio of the floor to the peak comes from a fit of the
    known r*r to all lags instead of an extrapolation to zero lag. The saved albedo is not registered.
    """
    comparison = None if truth is None else result.compare(truth)
    summary = summarise(result, truth, request_sha256, comparison)
    with staging_folder(folder) as staging:
        save_array(staging / "albedo.npy", np.ascontiguousarray(result.albedo, np.float32))
        save_array(staging / "autocorrelation.npy", result.estimate.values)
        if result.fields is not None:
            save_array(staging / "albedo_coarse.npy", np.ascontiguousarray(result.coarse_albedo, np.float32))
            if result.fields.deviation is not None:
                save_array(staging / "deviation.npy", result.fields.deviation)
            summary["fields"]["saved"] = fields and result.fields.field is not None
            if summary["fields"]["saved"]:
                result.fields.field.save(staging / "fields.npz")
        if result.samples is not None:
            save_array(staging / "samples.npy", result.samples.samples)
        save_image(staging / "albedo.png", result.albedo, 8 if result.fields is None else 1)
        save_figure(staging / "report.png", draw_report(result, comparison))
        save_json(staging / "result.json", summary)
        replace_files(staging, folder, RESULT_FILES, "result.json")
    return summary


def summarise(
    result: Outcome,
    truth: Truth | np.ndarray | None = None,
    request_sha256: str | None = None,
    comparison: Comparison | None = None,
) -> dict[str, Any]:
    """Return the content of result.json; the README describes its keys.

    Args:
        comparison: comparison of the result with the truth, if it is known.
    """
    estimate, measurement, reconstruction = result.estimate, result.measurement, result.reconstruction
    noise, compared = measurement.noise, {}
    floor_over_peak, floor_error = measurement.floor_over_peak, measurement.floor_over_peak_error
    if truth is not None:
        compared = {"pearson": (comparison or result.compare(truth)).pearson}
        floor_over_peak = floor_over_known_peak(estimate, result.truth_on_lags(truth), bool(measurement.interpolated))
        floor_error = None
    return {
        "input": estimate.name,
        **result.settings_as_dict(),
        "request_sha256": request_sha256,
        "object_found": result.object_found,
        "confidence": result.confidence,
        "noise": {
            "floor_over_peak": floor_over_peak,
            "floor_over_peak_error": floor_error,
            "dof": noise.dof if noise.dof_read else None,
            "dof_assumed": None if noise.dof_read else noise.dof,
            "detection_sigma": measurement.detection if np.isfinite(measurement.detection) else None,
            "lines_interpolated": list(measurement.interpolated),
        },
        "pitch_m": result.pitches_m and result.pitches_m[0],
        "pitches_m": result.pitches_m,
        "lag_pitches_m": estimate.pitches_m,
        "fields": result.fields and result.fields.as_dict(estimate.pitches_m),
        "residual": reconstruction.residual,
        "phase_retrieval_transfer": [round(value, 4) for value in reconstruction.transfer],
        "posterior": None if result.samples is None else summarise_samples(result.samples, estimate.pitches_m),
        **({} if estimate.record is None else estimate.record.as_dict()),
        **compared,
        "seconds": result.seconds,
    }


def summarise_samples(samples: Samples, pitches_m: tuple[float, float] | None) -> dict[str, Any]:
    """Return clusters with their probabilities and credible intervals of sizes, in metres if the pitch is known, for JSON."""
    height, width = pitches_m or (1.0, 1.0)
    units = {"width": width, "height": height, "area": width * height}
    names = {size: size if pitches_m is None else f"{size}_{'m2' if size == 'area' else 'm'}" for size in SIZES}
    intervals = {
        names[size]: {
            f"{100.0 * probability:.0f} %": [units[size] * end for end in samples.interval(size, probability)]
            for probability in (0.5, 0.8, 0.95)
        }
        for size in SIZES
    }
    clusters = [{"probability": cluster.probability, "samples": cluster.members} for cluster in samples.clusters]
    errors = None if samples.errors is None else {size: list(errors) for size, errors in samples.errors.items()}
    return {"samples": len(samples), "answers": clusters, "intervals": intervals, "size_errors": errors}


def floor_over_known_peak(estimate: Estimate, truth: np.ndarray, has_lines: bool) -> float | None:
    """Return floor b over peak (r*r)(0) from a fit of the known r*r, smoothed by the patch window and the camera; None
    without signal.
    """
    known = autocorrelate(truth)
    signal = smooth_by_window(known)
    if estimate.transfer is not None:
        signal *= estimate.transfer
    if not signal.any() or not estimate.values.any():
        return None
    gain, floor = fit_known_signal(estimate.values, signal, lines=has_lines)
    return floor / (gain * peak_of_cell_means(known)) if gain > 0.0 else None
