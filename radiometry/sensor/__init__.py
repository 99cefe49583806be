"""The sensor as a chain of stages. Each stage samples its effect on a frame and predicts its effect on the estimate.

To add one, write a `Stage` in a new file, its parameter in `electronics.py`, and its line in `chain.py`. Renderer, prediction, plan,
exposure planner and comparison of cameras iterate the chain. `saturation.py` forecasts pixels that have their largest value.
"""
