"""What the gate's evidence is worth: how it is fitted on training seeds, how its probabilities hold on fresh ones."""
