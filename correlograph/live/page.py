"""Page of the live view: images, measured values and buttons, for browsers on this machine that know its address.

The address contains a random token. The server listens on the loopback interface only; without the token it answers "not found".
"""

from __future__ import annotations

import io
import logging
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from correlograph.errors import InputError
from correlograph.files.figures import add_scale_bar
from correlograph.live.session import LiveReport
from correlograph.live.threads import Acquisition
from invert.output.result import Result

REFRESH_MS = 500
SHOWN_PIXELS = 480
"""Largest side of an image on the page."""

PICTURES = ("frame", "histogram and contrast", "autocorrelation", "reconstruction", "path")
MIN_SILENCE_S = 3.0
"""Time without a frame after which the page states it."""

HISTOGRAM_STEP = 4
"""Step over rows and columns of a frame for its histogram."""


@dataclass(frozen=True)
class Page:
    """A running page: its address and its server."""

    address: str
    server: Any

    def wait(self) -> None:
        """Serve the page until the process is interrupted."""
        self.server.io_loop.start()


def serve(acquisition: Acquisition, folder: Path, port: int = 0) -> Page:
    """Start the server of the page. Raises InputError if the port is taken.

    Args:
        folder: where captures are saved.
        port: 0 for a free one.
    """
    import panel as pn

    for name in ("tornado.access", "asyncio"):  # requests of browsers, and browsers that leave in the middle of a message
        logging.getLogger(name).setLevel(logging.CRITICAL)
    token = secrets.token_urlsafe(24)
    try:
        server = pn.io.server.get_server(
            {token: lambda: _build(pn, acquisition, folder)},
            port=port,
            address="127.0.0.1",
            use_index=False,
            title="correlograph live",
        )
    except OSError as problem:
        raise InputError("--port", "a free port", f"{port} ({problem})", "choose another, or 0 for any") from None
    server.start()
    return Page(f"http://127.0.0.1:{server.port}/{token}", server)


def _build(pn: Any, acquisition: Acquisition, folder: Path) -> Any:
    """Build the page of one browser."""
    images = {name: pn.pane.PNG(None, width=320, height=320, name=name) for name in PICTURES}
    shown: list[Any] = [None]
    values, message = pn.pane.Markdown(sizing_mode="stretch_width"), pn.pane.Markdown()
    restart = pn.widgets.Button(name="Restart the estimate")
    balanced = pn.widgets.Button(name="Reconstruct with quality balanced")
    save = pn.widgets.Button(name="Save the frames", button_type="primary")
    save_film = pn.widgets.Button(name="Save the film")

    def write(what: Callable[[Path], Path]) -> None:
        try:
            message.object = f"saved: `{what(folder)}`"
        except InputError as problem:
            message.object = f"not saved: {problem}"

    def on_restart(event: object) -> None:
        acquisition.restart()
        message.object = f"the estimate starts again after frame {acquisition.received}"

    restart.on_click(on_restart)
    balanced.on_click(lambda event: acquisition.request("balanced"))
    save.on_click(lambda event: write(acquisition.session.save))
    save_film.on_click(lambda event: write(acquisition.save_film))

    def refresh() -> None:
        values.object = table(acquisition)
        now = (acquisition.latest, acquisition.estimate, acquisition.result)
        if shown[0] is None or any(new is not old for new, old in zip(now, shown[0], strict=True)):
            shown[0] = now
            found = pictures(acquisition)
            for name, image in images.items():
                image.object = found.get(name)
            columns["path"].visible = "path" in found

    columns = {name: pn.Column(f"### {name}", image) for name, image in images.items()}
    refresh()
    pn.state.add_periodic_callback(refresh, REFRESH_MS)
    buttons = pn.Row(restart, balanced, save, save_film)
    return pn.Column("# correlograph live", pn.Row(*columns.values()), buttons, message, values)


def pictures(acquisition: Acquisition) -> dict[str, bytes]:
    """Return the pictures of the page as PNG files, without those that do not exist yet."""
    frame, estimate, result = acquisition.latest, acquisition.estimate, acquisition.result
    found = {}
    if frame is not None:
        found["frame"] = png(np.sqrt(np.clip(frame, 0.0, None)), "gray")
        found["histogram and contrast"] = draw_trend(frame, list(acquisition.session.contrasts))
    if estimate is not None:
        found["autocorrelation"] = png(np.sqrt(np.clip(estimate.values - np.median(estimate.values), 0.0, None)), "magma")
    if result is not None:
        found["reconstruction"] = draw_albedo(result)
    if acquisition.film.path is not None:
        found["path"] = _as_png(acquisition.film.path.plot())
    return found


def draw_albedo(result: Result) -> bytes:
    """Return the reconstruction as a PNG file, with a scale bar if the camera is known."""
    figure = Figure(figsize=(3.2, 3.2))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.imshow(result.albedo, cmap="gray", vmin=0.0, vmax=float(result.albedo.max()) or 1.0)
    if result.pitches_m is not None:
        add_scale_bar(axes, result.pitches_m[1], *result.albedo.shape[::-1])
    return _as_png(figure)


def draw_trend(frame: np.ndarray, contrasts: list[float]) -> bytes:
    """Return the histogram of a frame, and the contrast of the latest frames, as a PNG file."""
    figure = Figure(figsize=(3.2, 3.2), layout="constrained")
    histogram, trend = figure.subplots(2, 1)
    histogram.hist(frame[::HISTOGRAM_STEP, ::HISTOGRAM_STEP].ravel(), 64, log=True, color="0.3")
    histogram.set_xlabel("value of a pixel", fontsize=8)
    trend.plot(contrasts, color="0.3")
    trend.set_xlabel("frame", fontsize=8)
    trend.set_ylabel("contrast", fontsize=8)
    trend.set_ylim(bottom=0.0)
    for axes in (histogram, trend):
        axes.tick_params(labelsize=7)
    return _as_png(figure)


def _as_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()


def png(image: np.ndarray, colours: str) -> bytes:
    """Return an image (H, W) as a PNG file of at most `SHOWN_PIXELS` a side; its brightest 0.1 % of pixels are clipped."""
    from matplotlib.image import imsave

    step = -(-max(image.shape) // SHOWN_PIXELS)
    small = image[::step, ::step]
    buffer = io.BytesIO()
    imsave(buffer, small, cmap=colours, vmin=float(small.min()), vmax=float(np.quantile(small, 0.999)) or 1.0, format="png")
    return buffer.getvalue()


def table(acquisition: Acquisition) -> str:
    """Return the measured values as a Markdown table."""
    rows = [("frames received", _arrival(acquisition))]
    if acquisition.dropped:
        rows.append(("frames dropped", f"{acquisition.dropped}, because this machine is slower than the camera"))
    if waiting := getattr(acquisition.source, "waiting", ""):
        rows.append(("waiting", waiting))
    for name, skipped in (("files", getattr(acquisition.source, "skipped", [])), ("frames", acquisition.skipped)):
        if skipped:
            rows.append((f"{name} skipped", f"{len(skipped)}, the latest {skipped[-1]}"))
    if acquisition.pending_quality:
        rows.append(("requested", f"a reconstruction with quality {acquisition.pending_quality}"))
    if acquisition.report is not None:
        rows += _report_rows(acquisition.report, acquisition.frames_per_s)
    if acquisition.result is not None:
        rows += _result_rows(acquisition.result)
    if acquisition.problem:
        rows.append(("stopped", acquisition.problem))
    elif acquisition.finished.is_set():
        rows.append(("stopped", "the reconstruction is sure enough, or the source has ended"))
    return "\n".join(["| | |", "|---|---|", *(f"| **{name}** | {value.replace('|', '/')} |" for name, value in rows)])


def _arrival(acquisition: Acquisition) -> str:
    """Return how many frames have arrived and how fast, or for how long none has."""
    silence = acquisition.seconds_without_frame
    if silence is None:
        return "0; waiting for the first"
    if silence > max(MIN_SILENCE_S, 3.0 / max(acquisition.frames_per_s, 1e-3)):
        return f"{acquisition.received}; the latest {silence:.0f} s ago"
    return f"{acquisition.received}, {acquisition.frames_per_s:.3g} per second"


def _report_rows(report: LiveReport, rate: float) -> list[tuple[str, str]]:
    frame = report.frame
    electrons = "" if frame.photoelectrons is None else f", {frame.photoelectrons:.3g} photoelectrons"
    rows = [
        ("frames in the estimate", str(report.frames)),
        ("mean of a pixel", f"{frame.mean:.4g}{electrons}"),
        ("saturated pixels", f"{100.0 * frame.saturated:.2g} %"),
        ("speckle contrast", f"{frame.contrast:.2f}"),
        ("speckle grain", f"{frame.grain_pixels:.3g} pixels"),
        ("detection", f"{report.detection:.1f} standard deviations (6 are needed)"),
        ("degrees of freedom K", f"{report.dof:.0f}"),
    ]
    if report.floor_over_peak is not None:
        rows.append(("floor over peak", f"{report.floor_over_peak:.3g}"))
    if report.error is not None:
        rows.append(("error of the estimate", f"{100.0 * report.error:.0f} %"))
    for name, count in (("object detected", report.detected_in_frames), ("image sharp", report.sharp_in_frames)):
        if count is not None:
            rows.append((name, "now" if count == 0 else f"after {count} more frames{_duration(count, rate)}"))
    return rows


def _duration(frames: int, rate: float) -> str:
    return f", {frames / rate:.0f} s" if rate > 0.0 else ""


def _result_rows(result: Result) -> list[tuple[str, str]]:
    quality = result.settings.quality
    rows = [("object", f"{'found' if result.object_found else 'none'}, confidence {result.confidence:.2f} ({quality})")]
    ratio = None if result.speckle_test is None else result.speckle_test.third_moment_ratio
    if ratio is not None:  # it is unknown in faint light
        rows.append(("third moment over that of speckle", f"{ratio:.2f}"))
    remarks = [*(("warning", warning) for warning in result.warnings), *(("note", note) for note in result.notes)]
    return rows + [(name, text.replace("|", "/")) for name, text in remarks]
