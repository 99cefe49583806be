"""Integrator `throughput`: light budget by Monte Carlo; `mi.render(scene)` returns it in dB."""

from __future__ import annotations

import mitsuba as mi

from sim.transport.monte_carlo import DEFAULT_SAMPLES, estimate_throughput


class Throughput(mi.SamplingIntegrator):
    """Render one value, shape (1, 1, 1): photoelectrons of a whole frame per laser photon, in dB.

    Parameter: `samples`, light paths; `spp` overrides it. A dark scene gives minus infinity.
    """

    def __init__(self, props: mi.Properties) -> None:
        mi.SamplingIntegrator.__init__(self, props)
        self.samples = int(props.get("samples", DEFAULT_SAMPLES))

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        del sensor, develop, evaluate
        per_frame_db = estimate_throughput(scene, int(spp) or self.samples, int(seed)).per_frame_db
        return mi.TensorXf([per_frame_db], shape=(1, 1, 1))

    def to_string(self) -> str:
        return f"Throughput[samples={self.samples}]"
