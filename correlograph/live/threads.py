"""Threads of the live view: one reads frames, one adds them to the estimate, one reconstructs."""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from threading import Condition, Event, Lock, Thread

import numpy as np

from correlograph.errors import InputError
from correlograph.files.output import output_folder
from correlograph.live.film import LiveFilm, Look
from correlograph.live.session import LiveReport, LiveSession, new_folder
from correlograph.live.sources import Frames
from invert.measure.estimate import Estimate
from invert.output.result import Result

INTERVAL_S = 1.0
"""Minimum time between two reconstructions."""

WAITING = 4
"""Frames that wait to be added. If more arrive, the oldest of them is dropped and counted."""


class _AbandonedError(Exception):
    """The process ends before this reconstruction does."""


class Acquisition:
    """Reads a source and keeps the latest report and reconstruction; `start` begins, `stop` ends.

    Attributes:
        report, result: the latest; None before.
        film: the reconstructions so far.
        received, dropped: frames of the source, and how many of them were never added.
        skipped: frames that the session refused, with the reason.
        pending_quality: quality of the reconstruction that was asked for and is not complete; empty if there is none.
        problem: why the source or the estimate ended; empty while all is well.
        until: confidence of a reconstruction at which reading stops; None to continue.
    """

    def __init__(self, source: Frames, session: LiveSession, until: float | None = None) -> None:
        self.source, self.session, self.until = source, session, until
        self.report: LiveReport | None = None
        self.estimate: Estimate | None = None
        self.result: Result | None = None
        self.film = LiveFilm()
        self.latest: np.ndarray | None = None
        self.received = self.dropped = 0
        self.skipped: list[str] = []
        self.problem = ""
        self.finished = Event()
        self._waiting: deque[tuple[int, np.ndarray]] = deque()
        self._arrived = Condition()
        self._abandoned = Event()
        self.pending_quality = ""
        self._restarts = 0
        self._state = Lock()  # held while what was found is replaced
        self._first_s = 0.0
        self._threads: list[Thread] = []
        self._times: deque[float] = deque(maxlen=32)

    def start(self) -> None:
        """Start the threads."""
        for work in (self._read, self._add, self._reconstruct):
            self._threads.append(Thread(target=self._guard, args=(work,), daemon=True))
            self._threads[-1].start()

    def stop(self) -> None:
        """Stop reading. Frames and results remain."""
        self.finished.set()
        with self._arrived:
            self._arrived.notify_all()

    def abandon(self) -> None:
        """Stop reading, and end a running reconstruction."""
        self._abandoned.set()
        self.stop()

    def restart(self) -> None:
        """Forget all frames, and what was found in them."""
        with self._state:
            self._restarts += 1
            self.session.restart()
            self.film = LiveFilm()
            self.report = self.estimate = self.result = None

    def join(self, timeout_s: float = 60.0) -> None:
        """Wait until the frames that were read are added and the last reconstruction is complete. The thread that reads the
        source is not waited for, because it may be blocked.
        """
        for thread in self._threads[1:]:
            thread.join(timeout_s)

    def save_film(self, folder: Path) -> Path:
        """Write the film so far into a new folder, and return it. Raises InputError without an image."""
        lasts_s = self._times[-1] - self._first_s if self._times else 0.0
        interval_s = lasts_s / (self.received - 1) if self.received > 1 and lasts_s > 0.0 else None
        return self.film.film(interval_s).save(new_folder(output_folder(folder), "film"))

    def request(self, quality: str) -> None:
        """Ask for one reconstruction of another quality; the ones after it are `fast` again."""
        self.pending_quality = quality

    @property
    def seconds_without_frame(self) -> float | None:
        """Time since the latest frame arrived; None before the first."""
        return time.monotonic() - self._times[-1] if self._times else None

    @property
    def frames_per_s(self) -> float:
        """Rate at which frames arrive."""
        times = list(self._times)
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 and times[-1] > times[0] else 0.0

    def _guard(self, work) -> None:
        try:
            work()
        except Exception as problem:  # a camera's own reader may raise anything, and the page must say why it stands still
            self.problem = str(problem) if isinstance(problem, InputError) else f"{type(problem).__name__}: {problem}"
            self.stop()

    def _read(self) -> None:
        for frame in self.source:
            if self.finished.is_set():
                return
            self.received += 1
            self._times.append(time.monotonic())
            self._first_s = self._times[-1] if self.received == 1 else self._first_s
            with self._arrived:
                self._waiting.append((self.received - 1, frame))
                if len(self._waiting) > WAITING:
                    self._waiting.popleft()
                    self.dropped += 1
                self._arrived.notify_all()
        self.stop()

    def _add(self) -> None:
        while True:
            with self._arrived:
                self._arrived.wait_for(lambda: self._waiting or self.finished.is_set())
                if not self._waiting:
                    return
                number, frame = self._waiting.popleft()
            try:
                self.session.add(frame, number)
            except InputError as problem:
                self.skipped.append(str(problem))
                continue
            self.latest = np.asarray(frame)

    def _reconstruct(self) -> None:
        seen = 0
        while True:
            begin, restarts, all_added = time.monotonic(), self._restarts, not self._threads[1].is_alive()
            estimate, requested = self.session.estimate() if self.session.frames else None, self.pending_quality
            is_new = estimate is not None and estimate.record is not None and estimate.record.frames != seen
            if estimate is not None and estimate.record is not None and (is_new or requested):
                seen, shown = estimate.record.frames, self.result
                if shown is None or shown.track is None:
                    self._show(restarts, estimate, seen)
                try:
                    look = self.session.reconstruct(estimate, requested or "fast", self._go_on)
                except _AbandonedError:
                    return
                if look is None or not self._show(restarts, look.result.estimate, look.frames, look):
                    continue
                if requested:
                    self.pending_quality = ""
                if self.until is not None and look.result.confidence >= self.until:
                    self.stop()
            elif all_added:
                return
            time.sleep(max(0.05, INTERVAL_S - (time.monotonic() - begin)))

    def _show(self, restarts: int, estimate: Estimate, frames: int, look: Look | None = None) -> bool:
        """Show an estimate from a number of frames, and what was reconstructed from it; return False if a restart has overtaken it."""
        report = self.session.report(estimate, frames)
        with self._state:
            if restarts != self._restarts:
                return False
            self.estimate, self.report = estimate, report
            if look is not None:
                self.result = look.result
                if look.result.object_found:
                    self.film.add(look)
        return True

    def _go_on(self, steps: int = 1) -> None:
        """Progress of a reconstruction: end it if the process ends."""
        if self._abandoned.is_set():
            raise _AbandonedError
