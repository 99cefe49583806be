"""
Render the lab, reconstruct the letter
======================================

The lab of Metzler et al. 2020: two frames of 1/8 s of a hidden letter F, and the reconstruction from them.
"""

# %%
# Load a shipped scene by name. Keyword arguments set the parameters of the scene file. The drawing shows the scene to scale.

import matplotlib.pyplot as plt

import correlograph as cg

scene = cg.load("corner_letter", exposure=0.125, albedo="F.png")
scene

# %%
# Each frame shows speckle, not the letter. A result displays its report: a corner of the first frame, the autocorrelation
# estimate and the reconstruction. No autocorrelation determines the position or a rotation by 180 degrees. Register the
# reconstruction to the truth before you compare them.

capture = cg.render(scene, frames=2, seed=1)
result = cg.reconstruct(capture, quality="fast")
result

# %%
comparison = result.compare(cg.Truth.of(capture))
figure, axes = plt.subplots(1, 2, figsize=(6, 3), layout="constrained")
for panel, (title, albedo) in zip(
    axes, {"registered": comparison.albedo, "true albedo": comparison.truth}.items(), strict=True
):
    panel.imshow(albedo, cmap="gray")
    panel.set(title=title, xticks=[], yticks=[])
print(f"correlation {comparison.pearson:.2f}, one pixel is {result.estimate.pitches_m[0] * 1e6:.0f} um")
