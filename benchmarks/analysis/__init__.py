"""What an agent or an environment is like: one question per script."""
