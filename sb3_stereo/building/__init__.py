"""A configuration becomes environments, a model and callbacks."""
