"""Output files of a retrieval: arrays, pictures and result.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture_folder import check_whole
from correlograph.files.images import read_picture
from correlograph.files.output import save_array, save_json
from correlograph.lags import OBJECT_SIDE
from invert.albedo.metrics import aligned_pearson
from invert.albedo.posterior import SIZES, Posterior
from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement
from invert.methods import Reconstruction
from invert.output.report import save_picture, save_report
from radiometry.autocorrelation import autocorrelate, peak_of_cell_means, window_smooth
from radiometry.noise.level import fit_known_signal


def read_truth(path: Path) -> np.ndarray:
    """A known albedo, float32 (64, 64), one pixel a lag (cell means). Raises InputError where it is not one."""
    if not path.is_file():
        raise InputError("--truth", "an albedo, one pixel a lag", f"no {path}", "check the path")
    check_whole(path.parent)
    truth, _ = read_picture(path)
    if truth.shape != (OBJECT_SIDE, OBJECT_SIDE) or not np.isfinite(truth).all() or (truth < 0.0).any():
        raise InputError("--truth", f"a {OBJECT_SIDE} x {OBJECT_SIDE} albedo, one pixel a lag, zero or more",
                         f"shape {truth.shape} in {path.name}", "resample it to the lag pitch")
    return truth


def check_truth_pitch(path: Path, pitches_m: tuple[float, float] | None) -> None:
    """Refuse a truth whose pitch, read from the sim.json beside it, differs from the estimate's."""
    beside = path.with_name("sim.json")
    if pitches_m is None or not beside.is_file():
        return
    try:
        content = json.loads(beside.read_text())
        truth_pitches_m = [float(pitch) for pitch in content.get("lag_pitches_m", [content["lag_pitch_m"]] * 2)]
    except (ValueError, KeyError, TypeError):
        return
    for own, pitch_m in zip(truth_pitches_m, pitches_m, strict=True):
        if abs(own - pitch_m) > 0.01 * pitch_m:
            raise InputError("--truth", f"a pitch of {pitch_m * 1e6:.4g} um, the estimate's", f"{own * 1e6:.4g} um in {beside}",
                             "leave --patch at auto or resample the truth")


def write_result(folder: Path, estimate: Estimate, measurement: Measurement, result: Reconstruction,
                 truth: np.ndarray | None, settings: dict[str, Any], seconds: dict[str, float]) -> dict[str, Any]:
    """Write albedo.npy, albedo.png, autocorrelation.npy, samples.npy where there are any, report.png and, last, result.json;
    returns its content.

    With a truth the report shows the albedo moved onto it, and the floor over peak is read by fitting the known
    r*r to all lags instead of extrapolating the measured ones to zero lag; the saved albedo stays where it is. `settings`
    hold the method's, the warnings and the numbers of the speckle test.
    """
    (folder / "result.json").unlink(missing_ok=True)  # no stale result.json beside a half-written result
    shown, drawn, comparison = result.albedo, result.posterior, {}
    floor_over_peak, floor_error = measurement.floor_over_peak, measurement.floor_over_peak_error
    if truth is not None:
        pearson, shown = aligned_pearson(result.albedo, truth)
        drawn = drawn and drawn.laid_over(shown)
        comparison = {"pearson": pearson}
        floor_over_peak, floor_error = floor_over_known_peak(estimate, truth, bool(measurement.interpolated)), None
    summary = {
        "input": estimate.name,
        **settings,
        "object_found": result.object_found,
        "confidence": result.confidence,
        "noise": {
            "floor_over_peak": floor_over_peak,
            "floor_over_peak_error": floor_error,
            "dof": measurement.noise.dof if measurement.noise.dof_read else None,
            "dof_assumed": None if measurement.noise.dof_read else measurement.noise.dof,
            "detection_sigma": measurement.detection if np.isfinite(measurement.detection) else None,
            "lines_interpolated": list(measurement.interpolated),
        },
        "pitch_m": estimate.pitches_m and estimate.pitches_m[0],
        "pitches_m": estimate.pitches_m,
        "residual": result.residual,
        "phase_retrieval_transfer": [round(value, 4) for value in result.transfer],
        "posterior": None if result.posterior is None else summary_of(result.posterior, estimate.pitches_m),
        **estimate.facts,
        **comparison,
        "seconds": seconds,
    }
    save_array(folder / "albedo.npy", np.ascontiguousarray(result.albedo, np.float32))
    save_array(folder / "autocorrelation.npy", estimate.lags)
    (folder / "samples.npy").unlink(missing_ok=True)
    if result.posterior is not None:
        save_array(folder / "samples.npy", result.posterior.samples)
    save_picture(folder / "albedo.png", result.albedo)
    save_report(folder / "report.png", frame=estimate.frame, estimate=estimate.lags, albedo=shown, truth=truth,
                posterior=drawn, numbers=_numbers(summary))
    save_json(folder / "result.json", summary)
    return summary


def summary_of(drawn: Posterior, pitches_m: tuple[float, float] | None) -> dict[str, Any]:
    """Answers with their probabilities, and credible intervals of sizes, in metres where the lag pitch is known, for JSON."""
    down, across = pitches_m or (1.0, 1.0)
    units = {"width": across, "height": down, "area": across * down}
    names = {size: size if pitches_m is None else f"{size}_{'m2' if size == 'area' else 'm'}" for size in SIZES}
    intervals = {names[size]: {f"{100.0 * probability:.0f} %": [units[size] * end for end in drawn.interval(size, probability)]
                               for probability in (0.5, 0.8, 0.95)} for size in SIZES}
    answers = [{"probability": one.probability, "samples": one.members} for one in drawn.alternatives]
    return {"samples": len(drawn.samples), "answers": answers, "intervals": intervals}


def floor_over_known_peak(estimate: Estimate, truth: np.ndarray, lines: bool) -> float | None:
    """b / (r*r)(0) by a fit of the known r*r, window-smoothed and seen through the camera; None without signal."""
    known = autocorrelate(truth)
    signal = window_smooth(known)
    if estimate.transfer is not None:
        signal *= estimate.transfer
    if not signal.any() or not estimate.lags.any():
        return None
    gain, floor = fit_known_signal(estimate.lags, signal, lines=lines)
    return floor / (gain * peak_of_cell_means(known)) if gain > 0.0 else None


def _numbers(summary: dict[str, Any]) -> list[str]:
    """The lines below a report's panels."""
    noise, name = summary["noise"], summary["input"]
    found = "object found" if summary["object_found"] else "NO OBJECT_SIDE FOUND"
    parts = [f"floor/peak {noise['floor_over_peak']:.3g}" if noise["floor_over_peak"] is not None else "floor/peak unknown",
             f"K {noise['dof']:.3g}" if noise["dof"] is not None else "K unbounded"]
    if summary["pitch_m"] is not None:
        parts.append(f"{summary['pitch_m'] * 1e6:.0f} um a lag")
    if "pearson" in summary:
        parts.append(f"correlation with the truth {summary['pearson']:.2f}")
    parts.append(f"{summary['method']}, {summary['seconds']['retrieval']:.1f} s")
    lines = [name, f"{found}, confidence {summary['confidence']:.2f}", ", ".join(parts), *summary["warnings"][:3]]
    return [line if len(line) < 130 else f"{line[:127]}..." for line in lines]
