"""The result tables: their cells are trained, recorded and reported."""
