"""Forward model of the estimate, its likelihood, and refinement by the likelihood."""
