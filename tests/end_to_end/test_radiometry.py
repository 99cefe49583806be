"""The radiometry commands: account, exposure planner, validation."""

import json

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import correlograph as cg
from correlograph.commands.exposure_plan import main as plan
from correlograph.commands.light_budget import main as account
from correlograph.commands.noise_validation import main as validate
from radiometry.exposure_planner import divide_for_fields
from radiometry.prediction import predict
from radiometry.validation.lab_noise import lab_floor
from scenes import scene_path

SCENE = scene_path("corner_letter")


def test_radiometry_json_matches_reference_values(command):
    code, out, err = command(account, SCENE, "--json")
    result = json.loads(out)
    assert (code, err) == (0, "")
    assert result["per_pixel_db"] == pytest.approx(-182.0, abs=1.5)
    assert result["photons_per_second"] == pytest.approx(2.7e6, rel=0.35)
    assert sum(row["db"] for row in result["rows"]) == pytest.approx(result["per_pixel_db"])
    low, high = result["monte_carlo"]["interval_db"]
    assert low < result["per_frame_db"] < high
    assert result["floor_over_peak"] == pytest.approx(0.04, rel=0.05)
    assert result["dof"] == pytest.approx(325, rel=0.01)
    code, text, _ = command(account, SCENE)
    assert "closed form" in text
    assert "laser safety" in text


def test_definitions_scale_the_account(command):
    def run(*definitions: str) -> dict:
        options = [part for definition in definitions for part in ("-D", definition)]
        return json.loads(command(account, SCENE, "--json", "--samples", "10000", *options)[1])

    base, far, dim = run(), run("standoff=2"), run("power=0.03")
    assert far["per_frame_db"] - base["per_frame_db"] == pytest.approx(-6.02, abs=0.02)
    assert far["monte_carlo"]["per_frame_db"] - base["monte_carlo"]["per_frame_db"] == pytest.approx(-6.02, abs=0.02)
    assert dim["photons_per_second"] == pytest.approx(0.1 * base["photons_per_second"])
    dark = run("power=0")
    assert dark["floor_over_peak"] is None
    assert dark["photons_per_second"] == 0.0


def test_a_missing_baffle_is_reported(command, tmp_path):
    text = SCENE.read_text().replace('"F.png"', f'"{SCENE.parent / "F.png"}"').replace('x="0.095" z="0.6"', 'x="5" z="0.6"')
    looks_at = '<lookat origin="0.1039558, 0, 0.4890738" target='
    facing = text.replace(looks_at + '"0, 0, 0"', looks_at + '"0, 0.6, 0.62"')
    for name, scene, is_warned in (("away", text, False), ("facing", facing, True)):
        (tmp_path / f"{name}.xml").write_text(scene)
        code, out, err = command(account, tmp_path / f"{name}.xml", "--json")
        assert code == 0
        assert ("baffle" in err) == is_warned
        assert ("baffle" in " ".join(json.loads(out)["warnings"])) == is_warned


def test_one_frame_of_one_patch_is_refused(command, tmp_path):
    text = SCENE.read_text().replace('"F.png"', f'"{SCENE.parent / "F.png"}"')
    text = text.replace('name="width" value="2464"', 'name="width" value="250"').replace(
        'name="height" value="2056"', 'name="height" value="250"'
    )
    (tmp_path / "small.xml").write_text(text)
    code, _, err = command(account, tmp_path / "small.xml", "--frames", "1")
    assert code == 2
    assert "single patch" in err


def test_a_plan_finer_than_the_object_allows_is_refused(command, tmp_path):
    code, _, err = command(plan, SCENE, "--budget-s", "1", "--resolution-m", "1e-4", "-o", tmp_path)
    assert code == 2
    assert "64 lags" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-D", "power=-1"], "power"),
        (["--samples", "1"], "samples"),
        (["-D", "standoff=0.2"], "0.259"),
        (["--seed", "9" * 20], "--seed"),
        (["-D", "standoff=0"], "virtual_detector"),
        (["--frames", "0"], "--frames"),
    ],
)
def test_bad_input_is_one_line(command, arguments, words):
    code, out, err = command(account, SCENE, *arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err


@pytest.mark.slow
def test_the_planned_optimum_is_the_rendered_one(command, tmp_path):
    code, _, _ = command(plan, SCENE, "--budget-s", "0.25", "--check", "20", "-o", tmp_path)
    assert code == 0
    result = json.loads((tmp_path / "plan.json").read_text())
    errors = {int(frames): error for frames, error in result["rendered_error"].items()}
    for division in result["divisions"]:
        if 4 <= division["frames"] <= 20:  # two frames scatter by a tenth themselves
            assert errors[division["frames"]] == pytest.approx(division["error"], rel=0.15)
    assert errors[result["chosen"]["frames"]] < 1.1 * min(errors.values())
    assert (tmp_path / "plan.png").exists()
    code, _, err = command(plan, SCENE, "--budget-s", "0", "-o", tmp_path)
    assert code == 2
    assert "--budget-s" in err


@pytest.mark.slow
@pytest.mark.parametrize(("letter", "half_period_m"), [("F", 190e-6), ("7", 130e-6), ("R", 90e-6)])
def test_a_plan_for_fields_takes_the_fewest_frames(letter, half_period_m):
    """One frame fewer, or four per cent less light, would not do."""
    geometry = cg.load("corner_letter", albedo=f"{letter}.png").geometry
    found = divide_for_fields(geometry, half_period_m)
    assert found.fields.suffices
    assert found.fields.resolution_m <= half_period_m
    prediction = predict(geometry.with_exposure(0.96 * found.exposure_s))
    fewer = prediction.forecast_fields(found.frames - 1)
    assert not fewer.suffices
    assert fewer.resolution_m > half_period_m


@pytest.mark.slow
def test_a_plan_for_fields_by_the_command(command, tmp_path):
    code, out, _ = command(plan, SCENE, "--fields-m", "150e-6", "-o", tmp_path)
    assert code == 0
    assert "enough" in out
    result = json.loads((tmp_path / "plan.json").read_text())
    assert result["chosen"]["fields"]["resolution_m"] <= 150e-6
    assert result["budget_s"] == pytest.approx(result["chosen"]["frames"] * result["chosen"]["exposure_s"])
    for finer, words in (("1e-6", "or coarser"), ("-1", "--fields-m")):
        code, out, err = command(plan, SCENE, "--fields-m", finer)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err


def test_lab_floor_falls_as_one_over_exposure(measured):
    fit = lab_floor(measured)
    assert fit["a_s"] == pytest.approx(0.037, rel=0.25)
    assert 0.0 < fit["c"] < 0.03
    broken = max(fit["points"], key=lambda point: point["exposure_s"])
    assert broken["floor_over_peak"] > 2.0 * (fit["a_s"] / broken["exposure_s"] + fit["c"])


@pytest.mark.slow
def test_validation_slopes(command, tmp_path, measured):
    code, _, _ = command(validate, "-o", tmp_path, "--measured", measured)
    assert code == 0
    result = json.loads((tmp_path / "validation.json").read_text())
    for name in ("rendered", "measured"):
        assert result[name]["variance_over_mean_squared"] == pytest.approx(1 / 64, rel=0.15)
        assert result[name]["variance_over_mean_times_n"] == pytest.approx(1.0, rel=0.15)
    assert all(np.isfinite(point["variance"]) for point in result["rendered"]["exposure"])
    assert {path.name for path in tmp_path.glob("*.png")} == {"noise_statistics.png", "photon_budget.png", "lab_floor.png"}
