"""Many captures in one command: found, inverted to the same bytes by any number of workers, resumed, and listed."""

import json

import numpy as np
import pytest
from PIL import Image

from correlograph.errors import InputError
from correlograph.version import code_sha256
from invert.__main__ import main
from invert.batch.captures import Job, find_captures, skipped_folders
from invert.request import Request
from tests.light import speckle


def frame_of_an_l(seed: int) -> np.ndarray:
    """Frame (384, 320) of a bright L on a wall."""
    amplitude = np.zeros((80, 50))
    amplitude[:, :12], amplitude[68:] = 1.0, 1.0
    return speckle(amplitude, (384, 320), np.random.default_rng(seed)).astype(np.float32)


@pytest.fixture
def captures(tmp_path):
    folder = tmp_path / "captures"
    for number, name in enumerate(("day 1", "day 2")):
        (folder / name).mkdir(parents=True)
        for frame in range(2):
            np.save(folder / name / f"{frame}.npy", frame_of_an_l(2 * number + frame))
    return folder


def results(folder) -> dict:
    """Albedos and results, but for times."""
    found = {path.parent.name: path.read_bytes() for path in folder.glob("*/albedo.npy")}
    for path in folder.glob("*/result.json"):
        content = json.loads(path.read_text())
        del content["seconds"]
        found[path.parent.name, "result"] = content
    return found


@pytest.mark.slow
def test_any_number_of_workers_and_a_second_run(captures, tmp_path):
    """The same bytes; what is done is kept, and done again when more is asked."""
    for workers in ("1", "2"):
        main([str(captures), "-o", str(tmp_path / workers), "--method", "er", "--quality", "fast", "--workers", workers])
    one = results(tmp_path / "1")
    assert one == results(tmp_path / "2")
    assert ("day 1", "result") in one
    assert one["day 1"] != one["day 2"]
    sheet = np.asarray(Image.open(tmp_path / "1" / "contact_sheet.png").convert("L"))
    assert (sheet < 50).mean() > 0.3
    assert (sheet > 200).any()

    files = sorted((tmp_path / "1").glob("*/*"))
    times = [file.stat().st_mtime_ns for file in files]
    main([str(captures), "-o", str(tmp_path / "1"), "--method", "er", "--quality", "fast"])
    assert [file.stat().st_mtime_ns for file in files] == times
    np.save(captures / "day 2" / "0.npy", frame_of_an_l(7))
    main([str(captures), "-o", str(tmp_path / "1"), "--method", "er", "--quality", "fast"])
    again = results(tmp_path / "1")
    assert again["day 1"] == one["day 1"]
    assert again["day 2"] != one["day 2"]
    assert (tmp_path / "1" / "day 1" / "result.json").stat().st_mtime_ns in times


def test_results_of_other_code_are_not_kept(tmp_path, monkeypatch):
    for package in ("correlograph", "invert", "radiometry"):
        (tmp_path / package / "part").mkdir(parents=True)
        (tmp_path / package / "part" / "one.py").write_text("value = 1\n")
    before = code_sha256(tmp_path)
    (tmp_path / "invert" / "notes.txt").write_text("none")
    code_sha256.cache_clear()
    assert code_sha256(tmp_path) == before
    (tmp_path / "invert" / "part" / "one.py").write_text("value = 2\n")
    code_sha256.cache_clear()
    assert code_sha256(tmp_path) != before
    np.save(tmp_path / "0.npy", frame_of_an_l(1))
    job = Job(Request()).sha256([tmp_path / "0.npy"])
    monkeypatch.setattr("invert.batch.captures.code_sha256", lambda: "other")
    assert Job(Request()).sha256([tmp_path / "0.npy"]) != job


@pytest.mark.slow
def test_failed_captures_are_listed_and_the_others_finished(captures, tmp_path):
    (captures / "day 0").mkdir()
    (captures / "day 0" / "0.npy").write_bytes(b"no frame")
    with pytest.raises(InputError, match="1 of 3 that cannot, the first day 0"):
        main([str(captures), "-o", str(tmp_path / "out"), "--method", "er", "--quality", "fast"])
    rows = json.loads((tmp_path / "out" / "captures.json").read_text())["captures"]
    assert [row["name"] for row in rows] == ["day 0", "day 1", "day 2"]
    assert ["error" in row for row in rows] == [True, False, False]
    table = (tmp_path / "out" / "table.md").read_text().splitlines()
    assert len(table) == 5
    assert table[2].startswith("| day 0 |")
    assert "npy" in table[2]
    assert not (tmp_path / "out" / "day 0").exists()


def test_options_are_refused_before_anything_is_written(captures, tmp_path):
    for option in ("--truth", "--weights", "--dark"):
        with pytest.raises(InputError, match=option):
            main([str(captures), "-o", str(tmp_path / "out"), option, str(tmp_path / "missing.npy")])
    assert not list((tmp_path / "out").glob("*"))


def test_capture_discovery(captures, tmp_path):
    """A folder of frames, a folder of such folders, several of either; all files given together."""
    assert list(find_captures([str(captures)], False)) == ["day 1", "day 2"]
    assert list(find_captures([str(captures / "day 2")], False)) == [""]
    assert list(find_captures([str(captures / "day 1"), str(captures / "day 2")], False)) == ["day 1", "day 2"]
    (tmp_path / "more" / "day 3").mkdir(parents=True)
    np.save(tmp_path / "more" / "day 3" / "0.npy", frame_of_an_l(9))
    assert list(find_captures([str(tmp_path / "more")], False)) == ["day 3"]
    assert list(find_captures([str(captures), str(tmp_path / "more")], False)) == ["day 1", "day 2", "day 3"]
    for name, file in (("notes", "a.txt"), ("empty", None), ("older/day 0", "0.npy")):
        (captures / name).mkdir(parents=True)
        if file:
            (captures / name / file).write_text("none")
    assert [one.name for one in skipped_folders([str(captures)])] == ["empty", "notes"]
    (captures / ".correlograph-partial-7").mkdir()  # what a killed run leaves
    np.save(captures / ".correlograph-partial-7" / "0.npy", frame_of_an_l(9))
    assert list(find_captures([str(captures)], False)) == ["day 1", "day 2"]
    files = [str(file) for file in sorted((captures / "day 1").iterdir())]
    assert [len(paths) for paths in find_captures(files, False).values()] == [2]
    assert list(find_captures(files, True)) == ["0", "1"]
    for inputs, autocorrelation, words in (
        ([files[0], str(captures)], False, "mixed"),
        ([str(captures)] * 2, False, "day 1 twice"),
        ([files[0]] * 2, True, "0 twice"),
        ([str(captures), "typo"], False, "no typo"),
    ):
        with pytest.raises(InputError, match=words):
            find_captures(inputs, autocorrelation)
    np.save(captures / "dark.npy", frame_of_an_l(8))
    with pytest.raises(InputError, match="both in"):
        find_captures([str(captures)], False)
