"""The edges of the commands: nothing lost, nothing half-written, nothing damaged taken for whole."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zarr
from PIL import Image

pytest.importorskip("mitsuba")

from correlograph.errors import InputError
from correlograph.files.capture_folder import MOVING
from data_gen.__main__ import main as data_gen
from data_gen.dataset import DatasetSplit, load_targets
from data_gen.preview import main as preview
from invert.__main__ import main as invert
from invert.training.warm_starts import load_warm_starts
from invert.training.warm_starts import main as warm_starts
from scenes import scene_path

SCENE = scene_path("corner_letter")


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    store = tmp_path_factory.mktemp("whole") / "set.zarr"
    data_gen([str(store), "--source", "shapes", "--count", "2100", "--workers", "1"])
    return store


@pytest.fixture
def copy(dataset, tmp_path) -> Path:
    import shutil

    return Path(shutil.copytree(dataset, tmp_path / "copy.zarr"))


@pytest.mark.parametrize("command_name", ["data_gen", "warm_starts"])
@pytest.mark.parametrize("kind", ["folder", "file", "group", "array", "here", "nothing"])
def test_foreign_files_are_not_overwritten(tmp_path, command, monkeypatch, dataset, command_name, kind):
    """A folder with files, a file, another program's Zarr group or array, `.` and an empty name."""
    mine = tmp_path / "mine"
    if kind == "file":
        mine.write_text("thesis")
    elif kind == "group":
        zarr.create_group(mine).create_array("albedo", shape=(3,), dtype="f4")[:] = 1.0
    elif kind == "array":
        zarr.create_array(mine, shape=(3,), dtype="f4")[:] = 1.0
    else:
        mine.mkdir()
        (mine / "thesis.txt").write_text("years of work")
    before = contents(tmp_path)
    monkeypatch.chdir(mine if kind == "here" else tmp_path)
    address = {"here": ".", "nothing": ""}.get(kind, mine)
    if command_name == "data_gen":
        code, _, err = command(data_gen, address, "--source", "glyphs", "--count", 10, "--workers", 1)
    else:
        weights = Path(sys.modules["invert"].__file__).parent / "weights" / "unet.safetensors"
        code, _, err = command(warm_starts, dataset, "-o", address, "--weights", weights, "--count", 32)
    assert code == 2, err
    assert err.count("\n") == 1
    assert contents(tmp_path) == before


def test_a_store_with_a_file_missing_is_not_whole(copy, command):
    next((copy / "albedo" / "c").glob("1/0/0")).unlink()
    with pytest.raises(InputError, match="files of albedo missing"):
        load_targets(str(copy))
    assert command(preview, copy)[0] == 2


def test_a_store_with_a_changed_byte_is_found_out(copy):
    file = next((copy / "split" / "c").glob("0"))
    with zarr.config.set({"array.write_empty_chunks": True}):
        zarr.open_group(copy, mode="r+")["split"][5] ^= 1
    with pytest.raises(InputError, match="checksum"):
        load_targets(str(copy))
    with pytest.raises(InputError, match="checksum"):
        DatasetSplit(str(copy))
    file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(InputError, match="dataset"):
        load_targets(str(copy))


def test_a_changed_pixel_is_found_when_its_part_is_read(copy):
    zarr.open_group(copy, mode="r+")["albedo"][2060, 3, 5] ^= 1
    samples = DatasetSplit(str(copy))
    rows = np.flatnonzero(np.asarray(zarr.open_group(copy, mode="r")["split"]) == 0)
    assert samples[0]["albedo"].shape == (64, 64)
    with pytest.raises(InputError, match="checksum in part 1 of albedo"):
        samples[int(np.searchsorted(rows, 2048))]


@pytest.mark.parametrize("damage", ["zarr.json", "albedo/zarr.json", "complete/zarr.json", "dtype", "shape", "array", "format"])
def test_damaged_stores_are_one_line(copy, command, damage):
    group = zarr.open_group(copy, mode="r+")
    if damage.endswith(".json"):
        (copy / damage).write_text((copy / damage).read_text()[:40])
    elif damage == "format":
        group.attrs["format"] = 1
    else:
        import shutil

        shutil.rmtree(copy / "split")
        if damage != "array":
            shape, dtype = ((2100,), "f4") if damage == "dtype" else ((2099,), "u1")
            group.create_array("split", shape=shape, dtype=dtype)
    for main, arguments in ((preview, (copy,)), (data_gen, (copy, "--source", "shapes", "--count", 2100, "--workers", 1))):
        code, _, err = command(main, *arguments)
        assert code == 2, err
        assert err.count("\n") == 1
        assert len(err) < 600


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (("--count", 10**400), "--count"),
        (("--count", 10**18), "--count"),
        (("--workers", 1000), "--workers"),
        (("--scheduler", "tcp://127.0.0.1:9"), "--scheduler"),
        (("--scheduler", "nonsense"), "--scheduler"),
        (("--measurement", "noise-model", "--floor-over-peak", 1e5, 1e6), "measurement"),
        (("--measurement", "render", "--scene", "dark.xml"), "light from the hidden object"),
    ],
)
def test_invalid_datasets_leave_no_store(tmp_path, command, monkeypatch, extra, words):
    monkeypatch.chdir(tmp_path)
    text = SCENE.read_text().replace('"F.png"', f'"{tmp_path / "black.png"}"')
    Image.new("L", (64, 64)).save(tmp_path / "black.png")
    (tmp_path / "dark.xml").write_text(text)
    count = () if "--count" in extra else ("--count", 64)
    code, _, err = command(data_gen, "a.zarr", "--source", "glyphs", *count, *extra)
    assert code == 2, err
    assert words in err
    assert err.count("\n") == 1
    assert len(err) < 600
    assert not Path("a.zarr").exists()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("width", 60000, "film"),
        ("width", 2**31, "film"),
        ("width", 2**31 - 1, "film"),
        ("nested", 3000, "nested"),
        ("colour", 0, "rgb reflectance"),
    ],
)
def test_unrenderable_mitsuba_scenes_are_refused(tmp_path, command, name, value, words):
    """Films and nesting used to end or stop the process inside Mitsuba; a colour was taken for its luminance."""
    from sim.__main__ import main as sim

    text = SCENE.read_text().replace('"F.png"', f'"{SCENE.parent / "F.png"}"')
    inner = '<bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf>'
    if name == "colour":
        text = text.replace(inner, '<bsdf type="diffuse"><rgb name="reflectance" value="0.2,0.9,0.4"/></bsdf>', 1)
    elif name == "nested":
        text = text.replace(inner, '<bsdf type="twosided">' * value + inner + "</bsdf>" * value, 1)
    else:
        text = re.sub(r'(name="(?:width|height)" value=")[0-9]+', rf"\g<1>{value}", text)
    (tmp_path / "scene.xml").write_text(text)
    code, _, err = command(sim, tmp_path / "scene.xml", "--plan")
    assert (code, err.count("\n")) == (2, 1)
    assert words in err


@pytest.mark.parametrize("damage", ["truncated", "checksum", "archive"])
def test_damaged_image_is_rejected(tmp_path, command, rng, damage):
    file = tmp_path / "frame.png"
    Image.fromarray(rng.integers(0, 65535, (400, 400)).astype(np.uint16)).save(file)
    whole = file.read_bytes()
    if damage == "truncated":
        file.write_bytes(whole[: len(whole) // 2])
    elif damage == "checksum":
        file.write_bytes(whole[:-20] + bytes([whole[-20] ^ 1]) + whole[-19:])
    else:
        file.unlink()
        with open(tmp_path / "frame.npy", "wb") as stream:
            np.savez(stream, a=np.ones((300, 300)))
    code, _, err = command(invert, tmp_path, "-o", tmp_path / "out")
    assert code == 2, err
    assert err.count("\n") == 1
    assert not (tmp_path / "out" / "result.json").exists()


def test_mixed_captures_of_a_killed_run_are_refused(tmp_path, command):
    from sim.__main__ import main as sim

    assert command(sim, SCENE, "-o", tmp_path / "a", "--frames", 2)[0] == 0
    (tmp_path / "a" / MOVING).touch()
    code, _, err = command(invert, tmp_path / "a", "-o", tmp_path / "out", "--quality", "fast")
    assert (code, err.count("\n")) == (2, 1)
    assert "killed" in err
    assert command(sim, SCENE, "-o", tmp_path / "a", "--frames", 2)[0] == 0
    assert command(invert, tmp_path / "a", "-o", tmp_path / "out", "--quality", "fast")[0] == 0


@pytest.mark.parametrize("address", ["memory://x", "http://127.0.0.1:9/x", "s3://nobody/x", "foo://x", "file:///proc/x"])
def test_addresses_that_hold_no_store_are_one_line(command, address):
    code, _, err = command(data_gen, address, "--source", "glyphs", "--count", 10, "--workers", 1)
    assert (code, err.count("\n")) == (2, 1)
    assert len(err) < 600


def test_a_file_address_is_a_path(tmp_path, command):
    assert command(data_gen, f"file://{tmp_path / 'a.zarr'}", "--source", "glyphs", "--count", 64, "--workers", 1)[0] == 0
    assert (tmp_path / "a.zarr" / "zarr.json").is_file()


def test_an_evaluation_of_nothing_leaves_nothing(tmp_path, command):
    from invert.evaluation.evaluate import main as evaluate

    (tmp_path / "images").mkdir()
    Image.new("L", (300, 300), 7).save(tmp_path / "images" / "flat.png")
    for arguments in (
        ("--sets", "edges", "--images", tmp_path / "images"),
        ("--sets", "edges", "--images", tmp_path / "none"),
        ("--sets", "measured", "--measured", tmp_path),
    ):
        code, _, err = command(evaluate, "-o", tmp_path / "out", *arguments)
        assert (code, err.count("\n")) == (2, 1)
        assert not (tmp_path / "out").exists()


def test_training_stores_that_are_not_there_are_one_line(tmp_path):
    with pytest.raises(InputError, match="warm starts"):
        load_warm_starts([str(tmp_path / "none.zarr")])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "redirection", "name"),
    [
        ({"MPLBACKEND": "nonsense"}, "", "out"),
        ({"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}, "", "\u00f6ffnung"),
        ({}, "", os.fsdecode(b"latin-\xe9")),
        ({}, "2>&-", "out"),
        ({}, "2>&- >&- <&-", "out"),
        ({}, "2>/dev/full", "out"),
    ],
)
def test_terminals_and_names_of_every_kind(tmp_path, environment, redirection, name):
    """Results are written whatever the terminal is like, and whatever the output is called."""
    script = f'"$0" -m correlograph sim corner_letter --frames 1 -o "$1" {redirection} && '
    script += f'"$0" -m correlograph invert "$1" -o "$1/result" --method er --quality fast {redirection}'
    done = subprocess.run(
        ["bash", "-c", script, sys.executable, os.fsencode(tmp_path / name)],
        env={**os.environ, **environment},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / name / "result" / "result.json").is_file()


def test_a_reader_that_ends_early_is_no_error():
    done = subprocess.run(
        ["bash", "-c", '"$0" -m correlograph doctor | head -1', sys.executable], capture_output=True, check=False
    )
    assert done.stderr == b""
    assert done.stdout.startswith(b"Python")


def listening_sockets(session: int) -> set[str]:
    """Return the local addresses on which processes of a session listen."""
    inodes = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getsid(int(folder.name)) == session:
                inodes |= {os.readlink(link) for link in (folder / "fd").iterdir()}
        except OSError:
            continue
    lines = [line.split() for kind in ("tcp", "tcp6") for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]]
    return {line[1] for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in inodes}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").is_file(), reason="no /proc/net/tcp on this system")
def test_local_workers_listen_on_no_port(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "data_gen", tmp_path / "set.zarr", "--source", "glyphs", "--count", "4000", "--workers", "2"],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
    )
    seen = set()
    while process.poll() is None:
        seen |= listening_sockets(process.pid)
        time.sleep(0.05)
    assert process.returncode == 0
    assert seen == set()
