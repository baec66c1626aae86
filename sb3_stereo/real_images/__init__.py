"""Ordinary images in place of rendered frames."""
