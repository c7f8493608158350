"""Results as one web page that needs nothing else: figures, claims and tables of a folder, or the grid of a sweep."""
