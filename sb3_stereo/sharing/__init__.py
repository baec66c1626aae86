"""Runs for others: on the Hugging Face Hub, and as datasets of episodes."""
