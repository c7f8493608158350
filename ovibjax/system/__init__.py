"""The whole chain, encoder to edge queue, as one function of one grid point, and grids of it."""
