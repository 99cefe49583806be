"""Sources of the live view under random events: every good frame arrives once, whatever happens to its file."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import tifffile
from hypothesis import given
from hypothesis import strategies as st

import correlograph.live.sources as sources
from correlograph.files.capture import CameraMetadata
from correlograph.live.sources import GrowingFiles
from tests.fuzz.test_fuzz import drawn

SHAPE = (130, 140)
EVENTS = ("frame", "stack", "grow", "replace", "touch", "cut", "text", "empty", "delete", "delete folder", "other file", "nan")


class Folder:
    """A folder of recordings that events change, and the frames that a source must deliver next."""

    def __init__(self, path: Path) -> None:
        self.path, self.count, self.due = path, 0, []
        self.path.mkdir()

    def frames(self, count: int) -> np.ndarray:
        self.count += 1
        return np.random.default_rng(self.count).integers(1, 4000, (count, *SHAPE)).astype(np.uint16)

    def do(self, event: str, place: int) -> None:
        if event == "delete folder":
            shutil.rmtree(self.path, ignore_errors=True)
            return
        self.path.mkdir(exist_ok=True)
        stacks = sorted(self.path.glob("*.tif"))
        old = stacks[place % len(stacks)] if stacks else None
        new = self.path / f"{self.count:04d}.tif"
        if event == "frame":
            self.write(new, self.frames(1))
        elif event == "stack":
            self.write(new, self.frames(3))
        elif event == "nan":
            pages = self.frames(3).astype(np.float32)
            pages[1, 2, 3] = np.inf
            self.write(new, pages)
        elif event == "other file":
            (self.path / f"{self.count}.txt").write_text("notes")
        elif old is not None:
            self.change(event, old)

    def change(self, event: str, old: Path) -> None:
        if event == "grow":
            if (before := _readable(old)) is not None:
                self.write(old, np.concatenate([before, self.frames(2).astype(before.dtype)]), already=len(before))
        elif event == "replace":
            self.write(old, self.frames(2))
        elif event == "touch":
            old.touch()
        elif event == "cut":
            old.write_bytes(old.read_bytes()[: old.stat().st_size // 3])
        elif event == "text":
            old.write_text("no picture")
        elif event == "empty":
            old.write_bytes(b"")
        elif event == "delete":
            old.unlink()

    def write(self, file: Path, pages: np.ndarray, already: int = 0) -> None:
        staged = file.with_suffix(".partial")
        tifffile.imwrite(staged, pages, photometric="minisblack")
        staged.replace(file)
        self.due += list(pages[already:])


def _readable(file: Path) -> np.ndarray | None:
    try:
        pages = tifffile.imread(file)
    except Exception:
        return None
    return pages.reshape(-1, *SHAPE) if pages.size and pages.shape[-2:] == SHAPE else None


@drawn(60)
@given(events=st.lists(st.tuples(st.sampled_from(EVENTS), st.integers(0, 99)), min_size=3, max_size=25))
def test_every_good_frame_arrives_once(tmp_path_factory, events):
    folder = Folder(tmp_path_factory.mktemp("live") / "frames")
    source = GrowingFiles(folder.path, CameraMetadata())
    before = sources.PATIENCE_S
    sources.PATIENCE_S = -1.0  # a file that cannot be read is skipped at once
    try:
        for event, place in events:
            folder.do(event, place)
            arrived = list(source.poll())
            arrived += list(source.poll())  # what follows a frame that was skipped
            wanted = [frame for frame in folder.due if np.isfinite(frame).all()]
            found = [frame for frame in arrived if np.isfinite(frame).all()]
            assert len(found) == len(wanted), (event, source.skipped)
            for one, other in zip(found, wanted, strict=True):
                np.testing.assert_array_equal(one, other)
            folder.due = []
            assert bool(source.waiting) == (event == "delete folder")
    finally:
        sources.PATIENCE_S = before
