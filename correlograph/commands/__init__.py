"""Commands about the light of a scene: light budget, exposure plan, noise validation."""
