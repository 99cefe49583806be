"""Assessment of a reconstruction: consistency with speckle, confidence, warnings."""
