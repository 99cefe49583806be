"""
A parameter sweep
=================

How far can the object stand, at one exposure? Light falls with the fourth power of the distances, and lags grow.
"""

import matplotlib.pyplot as plt

import invert
import radiometry
import sim
from invert.albedo.metrics import aligned_pearson

standoffs = (0.7, 1.0, 1.5, 2.0, 3.0)
rows = []
for standoff in standoffs:
    scene = sim.load("corner_letter", standoff=standoff, exposure=1 / 32)
    capture = sim.render(scene, frames=2, seed=5)
    result = invert.reconstruct(capture, quality="fast")
    correlation, _ = aligned_pearson(result.albedo, capture.truth)
    forecast = radiometry.predict(scene)
    rows.append((correlation, forecast.floor_over_peak, result.confidence))
    print(
        f"{standoff} m: correlation {correlation:.2f}, confidence {result.confidence:.2f}, "
        f"floor over peak {forecast.floor_over_peak:.2g}, {forecast.pitches_m[0] * 1e6:.0f} um per lag"
    )

figure, panel = plt.subplots(figsize=(6, 3.5), layout="constrained")
panel.plot(standoffs, [row[0] for row in rows], "o-", label="correlation with the truth")
panel.plot(standoffs, [row[2] for row in rows], "s--", label="confidence")
panel.set(xlabel="standoff in m", ylim=(0, 1))
panel.legend()
