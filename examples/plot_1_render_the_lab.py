"""
Render the lab, recover the letter
==================================

The paper's lab: two frames of 1/8 s of a hidden F, and what they tell of it.
"""

# %%
# A scene is loaded by name (or file, dictionary, ``mi.Scene``); its parameters are those of the scene file.

import matplotlib.pyplot as plt

import invert
import sim

scene = sim.load("corner_letter", exposure=0.125, albedo="F.png")
capture = sim.render(scene, frames=2, seed=1)
result = invert.reconstruct(capture, quality="fast")

# %%
# Nothing but speckle in the frames; their autocorrelation is that of the albedo; the albedo is known up to a shift and the
# twin-image ambiguity.

figure, axes = plt.subplots(1, 4, figsize=(11, 3), layout="constrained")
lags = result.estimate.lags.copy()
lags[63, 63] = lags[63, 64]
pictures = {
    "frame, a corner": capture.frames[0][:257, :257],
    "autocorrelation": lags,
    "reconstruction": result.albedo,
    "truth": capture.truth,
}
for panel, (title, image) in zip(axes, pictures.items(), strict=True):
    panel.imshow(image, cmap="gray")
    panel.set(title=title, xticks=[], yticks=[])

print(f"confidence {result.confidence:.2f}, one pixel is {result.estimate.pitches_m[0] * 1e6:.0f} um")
