"""
Plan and tolerance
==================

A tolerance trades accuracy for speed. The plan predicts both before anything is rendered.
"""

import matplotlib.pyplot as plt

import sim
from sim.plan import Settings
from sim.plan_report import summary

# %%
# The text of ``python -m sim SCENE --plan``.

scene = sim.load("tilted_letter")
print(summary(scene.plan(), frames=2))

# %%
# ``statistical`` accuracy bounds the error of the expected autocorrelation. ``field`` accuracy bounds the error of the field of this
# realisation; slower propagators reach it. The figure shows predicted errors and durations:

figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
for accuracy, tolerance in (("statistical", 1e-2), ("field", 1e-2), ("field", 1e-5)):
    plan = scene.plan(Settings(accuracy, tolerance))
    print(
        f"{accuracy} {tolerance:g}: {plan.kernel.propagator} in {plan.kernel.precision}, "
        f"error {plan.kernel.predicted_error:.1e}, about {plan.kernel.seconds:.2f} s per field"
    )
    panel.loglog(plan.kernel.seconds, plan.kernel.predicted_error, "o", label=f"{accuracy} {tolerance:g}")
panel.set(xlabel="predicted seconds per field", ylabel="predicted error")
panel.legend()
