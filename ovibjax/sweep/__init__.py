"""Whole grids in compiled calls: describe a grid, run it, store it, resume it, spread it."""
