"""What is added to SB3's update."""
