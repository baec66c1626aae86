"""Images and videos of what the agent sees and does."""
