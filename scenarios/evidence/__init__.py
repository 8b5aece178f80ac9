"""The worth of the gate's evidence: fits on training seeds, and probabilities checked on fresh seeds."""
