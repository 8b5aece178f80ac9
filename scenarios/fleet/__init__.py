"""Many maps with known damage through `pgti-gtsam audit FOLDER`, and a city audited in parts."""
