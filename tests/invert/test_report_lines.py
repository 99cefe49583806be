"""The lines of text of a report."""

from dataclasses import replace

import numpy as np

import invert
from invert.output.report import LINE_WIDTH, report_lines
from tests.light import letter_cells, thrown


def test_the_names_of_many_frames_take_two_lines():
    frames = np.stack([thrown(letter_cells("F"), (514, 514), 257, np.random.default_rng(seed)) for seed in range(2)])
    result = invert.reconstruct(frames.astype(np.float32), method="classical", quality="fast", patch=257)

    def lines(count: int) -> list[str]:
        name = ", ".join(f"frame_{number:04d}.exr" for number in range(count))
        return report_lines(replace(result, estimate=replace(result.estimate, name=name)), None)

    few, many = lines(2), lines(500)
    assert few[0] == "frame_0000.exr, frame_0001.exr"
    assert many[0].startswith(few[0])
    assert many[1].endswith(" ...")
    assert max(map(len, many[:2])) <= LINE_WIDTH
    assert many[2:] == few[1:]
