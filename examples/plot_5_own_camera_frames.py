"""
Frames of your camera
=====================

Captured frames are 16-bit TIFF or PNG files, or arrays, in any unit. Wavelength, pixel pitch and distance give the scale.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from skimage import io

import invert
import sim

# %%
# Rendered frames replace those of a lab: a camera with 12 bits and an offset stores them.

rendered = sim.render("corner_letter", frames=2, seed=7)
folder = Path(tempfile.mkdtemp())
for number, frame in enumerate(rendered.frames):
    counts = np.clip(frame * 40 + 100, 0, 4095).astype(np.uint16)
    io.imsave(folder / f"shot_{number}.tif", counts, check_contrast=False)

# %%
# The same as ``python -m invert FOLDER --wavelength-m ... -o result``.

metadata = invert.CameraMetadata(wavelength_m=532e-9, pixel_pitch_m=6.9e-6, distance_m=1.0)
result = invert.reconstruct(folder, camera=metadata, quality="fast")
summary = result.save(folder / "result")
print(f"object found: {result.object_found}, confidence {result.confidence:.2f}")
print(f"files: {sorted(path.name for path in (folder / 'result').iterdir())}")

plt.figure(figsize=(3, 3), layout="constrained")
plt.imshow(result.albedo, cmap="gray")
plt.axis("off")
