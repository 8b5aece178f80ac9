"""Scripted experiments on top of `pgti_gtsam`, run from the checkout as `python -m scenarios NAME`."""
