"""
A parameter sweep
=================

How far away may the object be, at one exposure? The parameter ``standoff`` is the distance from the object to the virtual detector.
"""

import matplotlib.pyplot as plt

import correlograph as cg

standoffs = (0.7, 1.0, 1.5, 2.0, 3.0)
rows = []
for standoff in standoffs:
    scene = cg.load("corner_letter", standoff=standoff, exposure=1 / 32)
    capture = cg.render(scene, frames=2, seed=5)
    result = cg.reconstruct(capture, quality="fast")
    pearson = result.compare(cg.Truth.of(capture)).pearson
    rows.append((pearson, result.confidence, cg.predict(scene).floor_over_peak))
    print(f"{standoff} m: correlation {pearson:.2f}, {result}")

# %%
# A speckle grain is lambda z / D wide, so its area grows with the square of the distance, while the light per pixel falls with the
# square. Their product, the photoelectrons per grain, stays constant, and so does floor over peak. What limits the range is the
# number of grains in the frame: with larger grains, patches are larger and fewer, and K falls.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.plot(standoffs, [row[0] for row in rows], "o-", label="correlation with the truth")
left.plot(standoffs, [row[1] for row in rows], "s--", label="confidence")
left.set(xlabel="standoff in m", ylim=(0, 1))
left.legend(frameon=False)
right.plot(standoffs, [row[2] for row in rows], "o-")
right.set(xlabel="standoff in m", ylabel="floor over peak", ylim=(0, 1.2 * max(row[2] for row in rows)))
