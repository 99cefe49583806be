"""
Light budget and noise
======================

The number of photons that return, and the noise of the autocorrelation, before the first frame.
"""

import matplotlib.pyplot as plt

import radiometry
import sim

scene = sim.load("corner_letter")
budget = radiometry.light_budget(scene)
for name, factor in budget.rows:
    print(f"{name:40} {factor:.3g}")
print(f"{budget.per_pixel_db:.2f} dB per pixel, {budget.photoelectrons_per_pixel_s:.3g} photoelectrons per pixel and second")

# %%
# The noise floor falls with exposure. The signal-to-noise ratio saturates when the speckle itself is the noise.

exposures = [2.0**-power for power in range(10, -3, -1)]
forecasts = [radiometry.predict(sim.load("corner_letter", exposure=seconds)) for seconds in exposures]
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
left.loglog(exposures, [forecast.floor_over_peak for forecast in forecasts])
left.set(xlabel="exposure in s", ylabel="floor over peak")
right.semilogx(exposures, [forecast.signal_to_noise for forecast in forecasts])
right.set(xlabel="exposure in s", ylabel=f"signal-to-noise ratio, K = {forecasts[0].dof:.0f}")
