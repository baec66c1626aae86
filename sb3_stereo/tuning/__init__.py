"""Sweeps over hyper-parameters: what is searched, the trials on Ray Tune, and the report."""
