"""Sweeps over hyper-parameters: the search space, the trials on Ray Tune, and the report."""
