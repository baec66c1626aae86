"""Analyses of agents and environments: one question per script."""
