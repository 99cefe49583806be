"""
Plan and tolerance
==================

Speed is traded for accuracy by a tolerance, and the trade is predicted before anything is rendered.
"""

import matplotlib.pyplot as plt

import sim
from sim.plan import Settings
from sim.plan_report import summary

# %%
# What ``python -m sim SCENE --plan`` prints.

scene = sim.load("tilted_letter")
print(summary(scene.plan(), frames=2))

# %%
# ``statistical`` accuracy bounds the error of the expected autocorrelation; ``field`` that of this very realisation, which
# slower propagators can follow. Predicted errors and costs:

figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
for accuracy, tolerance in (("statistical", 1e-2), ("field", 1e-2), ("field", 1e-5)):
    plan = scene.plan(Settings(accuracy, tolerance))
    print(
        f"{accuracy} {tolerance:g}: {plan.kernel.propagator} in {plan.kernel.precision}, "
        f"error {plan.kernel.predicted_error:.1e}, about {plan.kernel.seconds:.2f} s a field"
    )
    panel.loglog(plan.kernel.seconds, plan.kernel.predicted_error, "o", label=f"{accuracy} {tolerance:g}")
panel.set(xlabel="predicted seconds a field", ylabel="predicted error")
panel.legend()
