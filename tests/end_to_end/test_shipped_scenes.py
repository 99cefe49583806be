"""Every shipped scene through every command, on the newest libLLVM and on an old one; what an old one cannot do is refused."""

import glob
import json
import math
import os
import subprocess
import sys

import pytest

pytest.importorskip("mitsuba")

from scenes import scene_path

SCENES = (
    "bar_target",
    "corner_letter",
    "glyph_mesh",
    "long_standoff",
    "moving_letter",
    "moving_pair",
    "occluded_letter",
    "strong_ambient",
    "tilted_letter",
    "two_depths",
)
OLD_LLVM = next(
    (
        path
        for place in ("/usr/lib/*/libLLVM-1[56]*.so*", "/usr/lib/llvm-1[56]/lib/libLLVM*.so*")
        for path in sorted(glob.glob(place))
    ),
    None,
)
WITHOUT_OLD = pytest.mark.skipif(OLD_LLVM is None, reason="neither libLLVM 15 nor 16 on this machine")


def run(*arguments: object, libllvm: str | None) -> subprocess.CompletedProcess:
    """A command, with another libLLVM than the newest if one is named."""
    environment = {**os.environ, **({"DRJIT_LIBLLVM_PATH": libllvm} if libllvm else {})}
    return subprocess.run(
        [sys.executable, "-m", *map(str, arguments)], capture_output=True, text=True, check=False, env=environment
    )


@pytest.mark.slow
@pytest.mark.parametrize("libllvm", [None, pytest.param(OLD_LLVM, marks=WITHOUT_OLD)], ids=["newest", "old"])
@pytest.mark.parametrize("name", SCENES)
def test_every_command_gives_a_result(tmp_path, name, libllvm):
    scene = scene_path(name)
    for arguments in (
        ("sim", scene, "-o", tmp_path / "frames", "--frames", 1),
        ("radiometry", scene, "--json", "--samples", 20000),
        ("radiometry.plan", scene, "--budget-s", 1, "-o", tmp_path / "plan"),
        (
            "invert",
            tmp_path / "frames",
            "-o",
            tmp_path / "result",
            "--quality",
            "fast",
            "--truth",
            tmp_path / "frames" / "truth.npy",
        ),
    ):
        done = run(*arguments, libllvm=libllvm)
        assert done.returncode == 0, f"{arguments[0]}: {done.stderr[-500:]}"
        if arguments[0] == "radiometry":
            assert math.isfinite(json.loads(done.stdout)["per_frame_db"])
    assert json.loads((tmp_path / "plan" / "plan.json").read_text())["chosen"]["error"] > 0.0
    result = json.loads((tmp_path / "result" / "result.json").read_text())
    assert math.isfinite(result["pearson"])


@pytest.mark.slow
@WITHOUT_OLD
@pytest.mark.parametrize(
    "surface",
    [
        '<bsdf type="principled"/>',
        '<bsdf type="roughplastic"/>',
        '<bsdf type="roughconductor"/>',
        '<bsdf type="mask"><float name="opacity" value="0.3"/><bsdf type="diffuse"/></bsdf>',
    ],
)
def test_surfaces_that_an_old_libllvm_cannot_compile_are_refused(tmp_path, surface):
    plate = (
        f'<shape type="rectangle" id="plate"><transform name="to_world"><scale value="0.01"/><translate x="0.3" z="0.2"/>'
        f"</transform>{surface}</shape></scene>"
    )
    text = scene_path("corner_letter").read_text().replace('"F.png"', f'"{scene_path("corner_letter").with_name("F.png")}"')
    (tmp_path / "scene.xml").write_text(text.replace("</scene>", plate))
    done = run("sim", tmp_path / "scene.xml", "--plan", libllvm=OLD_LLVM)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: plate: ")
    assert done.stderr.count("\n") == 1
