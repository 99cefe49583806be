"""
Compare methods
===============

The network and the classical methods on one capture of 1/64 s. ``python -m invert.evaluate`` compares them on whole test sets.
"""

import matplotlib.pyplot as plt

import correlograph as cg
import invert
import sim

capture = sim.render(sim.load("corner_letter", exposure=1 / 64, albedo="R.png"), frames=2, seed=4)
methods = ("unet", "classical", "hio", "raar", "altmin")
figure, axes = plt.subplots(1, len(methods) + 1, figsize=(12, 2.6), layout="constrained")
for panel, method in zip(axes, methods, strict=False):
    result = invert.reconstruct(capture, method=method, quality="fast")
    comparison = result.compare(cg.Truth.of(capture))
    panel.imshow(comparison.albedo, cmap="gray", vmin=0.0)
    panel.set(title=f"{method}, {result.seconds['retrieval']:.1f} s", xlabel=f"correlation {comparison.pearson:.2f}")
    panel.set(xticks=[], yticks=[])
axes[-1].imshow(comparison.truth, cmap="gray")
axes[-1].set(title="truth", xticks=[], yticks=[])
