"""`python -m radiometry.validate`: Figs. 4 and 5 of Metzler et al. 2020 from rendered frames and lab estimates, with the
prediction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.ranges import SEED
from radiometry.validation.lab_noise import corner, lab_floor, lab_over_exposure, lab_over_patches, slope

EXPOSURES_S = (1 / 512, 1 / 128, 1 / 32, 1 / 8, 1 / 4, 1 / 2, 1.0)
PATCHES = (1, 2, 3, 5, 10, 25, 64)
BUDGETS = ((100, 0.1), (10, 1.0), (1, 10.0))


def parser() -> ArgumentParser:
    p = ArgumentParser(
        prog="python -m radiometry.validate", description="Compare the noise model with rendered and measured speckle."
    )
    p.add_argument("-o", "--output", default="out/validation", help="folder for validation.json and the figures")
    p.add_argument("--scene", default="corner_letter", help="scene file or name of a shipped scene (default: corner_letter)")
    p.add_argument("--measured", type=Path, help="folder of published autocorrelations (PNG)")
    p.add_argument("--seed", type=SEED, default=0)
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Render series over exposures and patches, read those of the lab, fit both, plot."""
    options = parser().parse_args(argv)
    if options.measured is not None and not options.measured.is_dir():
        raise InputError("--measured", "a folder of autocorrelation pictures", options.measured, "check the path")
    from correlograph.files.manifest import claim
    from correlograph.files.output import output_folder, sole_writer

    folder = output_folder(options.output)
    with sole_writer(folder):
        names = ["validation.json", "noise_statistics.png", "photon_budget.png"]
        claim(folder, names + ["lab_floor.png"] * (options.measured is not None), overwrite=options.overwrite)
        _validate(folder, options)


def _validate(folder: Path, options: Any) -> None:
    from correlograph.files.output import save_json
    from radiometry.validation.figures import draw_budget, draw_floor, draw_statistics

    renderer = Renderer(options.scene, options.seed)
    series = {"rendered": {"exposure": renderer.over_exposure(), "patches": renderer.over_patches()}}
    if options.measured is not None:
        series["measured"] = {"exposure": lab_over_exposure(options.measured), "patches": lab_over_patches(options.measured)}
    result: dict[str, Any] = {
        name: {
            "variance_over_mean_squared": slope(
                [c["mean"] ** 2 for c in kinds["exposure"]], [c["variance"] for c in kinds["exposure"]]
            ),
            "predicted": 1.0 / kinds["exposure"][0]["dof"],
            "variance_over_mean_times_n": slope(
                [1.0 / c["dof"] for c in kinds["patches"]], [c["variance"] / c["mean"] ** 2 for c in kinds["patches"]]
            ),
            "predicted_times_n": 1.0,
            **kinds,
        }
        for name, kinds in series.items()
    }
    if options.measured is not None:
        result["lab_floor"] = lab_floor(options.measured)
        result["ideal_shot_floor_s"] = renderer.shot_floor_s()
    save_json(folder / "validation.json", result)
    draw_statistics(folder / "noise_statistics.png", result)
    draw_budget(folder / "photon_budget.png", renderer.budgets())
    if "lab_floor" in result:
        draw_floor(folder / "lab_floor.png", result["lab_floor"], result["ideal_shot_floor_s"])
    print(summary(result, folder))


class Renderer:
    """Frames of one scene at any exposure."""

    def __init__(self, scene: str | Path, seed: int) -> None:
        from radiometry.light_budget_rows import light_budget
        from radiometry.prediction import predict
        from sim.plan import check
        from sim.scene_file import load_scene
        from sim.scene_reader import read_geometry

        self.geometry, self.seed = read_geometry(load_scene(scene)[0]), seed
        check(self.geometry)
        if light_budget(self.geometry.light_path).per_pixel == 0.0:
            raise InputError("--scene", "light from the hidden object", "none", "choose another scene")
        self.prediction = predict(self.geometry)

    def frames(self, count: int, exposure_s: float):
        from sim.frame import Simulation

        simulation = Simulation(self.geometry.with_exposure(exposure_s))
        return (simulation.frame(self.seed, number) for number in range(count))

    def over_exposure(self) -> list[dict[str, float]]:
        """Return, per exposure, mean and variance of the signal-free corner of an estimate from two frames of 64 patches
        each, scaled to a maximum of 255 like the published images.
        """
        from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation

        grid = self.prediction.grid
        corners = []
        for exposure_s in EXPOSURES_S:
            estimate, dof = estimate_autocorrelation(self.frames(2, exposure_s), grid, "published")
            corners.append(corner(_as_picture(estimate), dof, exposure_s=exposure_s))
        return corners

    def over_patches(self) -> list[dict[str, float]]:
        """Return the series of two frames of 1/8 s, with the first patches of the grid only."""
        from radiometry.autocorrelation import PatchGrid
        from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation

        grid = self.prediction.grid
        size = grid.size
        frames = [frame.numpy() for frame in self.frames(2, 1 / 8)]
        corners = []
        for patches in PATCHES:
            rows = next(r for r in (8, 5, 2, 1) if patches % r == 0)
            columns = patches // rows
            if rows > grid.rows or columns > grid.columns:
                continue
            shape = (rows * size, columns * size)
            estimate, dof = estimate_autocorrelation(
                [frame[: shape[0], : shape[1]] for frame in frames], PatchGrid(size, rows, columns, shape), "published"
            )
            corners.append(corner(estimate, dof, patches=patches))
        return corners

    def shot_floor_s(self) -> float | None:
        """Return the ideal shot-noise Return a in seconds, where a / t is the floor over peak by shot noise alone at the
        exposure t.
        """
        floor = self.prediction.shot_floor_over_peak
        return None if floor is None else floor * self.geometry.camera.electronics.exposure_s

    def budgets(self) -> list[tuple[str, np.ndarray]]:
        """Return estimates for Fig. 4: a total exposure of 10 s, divided in three ways. For a single frame, the background
        is the mean of its patches.
        """
        from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation

        grid = self.prediction.grid
        return [
            (f"{count} x {exposure_s:g} s", estimate_autocorrelation(self.frames(count, exposure_s), grid)[0])
            for count, exposure_s in BUDGETS
        ]


def _as_picture(estimate: np.ndarray) -> np.ndarray:
    """Scale an estimate like the published images: with zero lag set to 0 and a maximum of 255, without rounding."""
    picture = np.array(estimate, np.float64)
    picture[picture.shape[0] // 2, picture.shape[1] // 2] = 0.0
    return picture * (255.0 / picture.max())


def summary(result: dict[str, Any], folder: Path) -> str:
    lines = []
    for name in ("rendered", "measured"):
        if name in result:
            entry = result[name]
            lines.append(
                f"{name}: variance / mean^2 = {entry['variance_over_mean_squared']:.4f} "
                f"(predicted {entry['predicted']:.4f}); "
                f"(variance / mean^2) N = {entry['variance_over_mean_times_n']:.3f} (predicted 1)"
            )
    if "lab_floor" in result:
        floor = result["lab_floor"]
        lines.append(
            f"lab floor over peak = ({floor['a_s']:.4f} +- {floor['a_error_s']:.4f} s) / t + {floor['c']:.4f} +- "
            f"{floor['c_error']:.4f}; ideal a = {result['ideal_shot_floor_s']:.4f} s"
        )
    lines.append(f"figures and numbers: {folder}")
    return "\n".join(lines)


if __name__ == "__main__":
    run_command(main)
