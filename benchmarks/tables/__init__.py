"""The tables of results: their cells are trained, recorded and reported."""
